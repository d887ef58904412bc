# SPDX-License-Identifier: MIT
# An image on Debian 13 in which scripts/fenicsx finds FEniCSx, and so simply runs the command:
#     docker build -t cruciform-petsc .
#     docker run --rm -v "$PWD:/work" cruciform-petsc cruciform-petsc run case.toml
# Not built where this was made; the packages are those of the root that scripts/fenicsx makes.
FROM debian:13
RUN apt-get update && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends \
    python3-dolfinx-real openmpi-bin python3-h5py python3-h5py-mpi python3-scipy python3-numba \
    python3-pint python3-pydantic python3-shapely python3-rich libopenblas0-serial python3-gmsh \
    python3-vtk9 python3-pyvista python3-matplotlib python3-jinja2 xvfb xauth python3-ezdxf \
    python3-svgelements python3-meshio python3-pandas python3-sphinx furo python3-myst-parser \
    python3-pytest python3-pytest-cov python3-hypothesis mypy git ca-certificates procps \
    && rm -rf /var/lib/apt/lists/*
COPY . /opt/cruciform_petsc
WORKDIR /work
ENTRYPOINT ["/opt/cruciform_petsc/scripts/fenicsx"]
CMD ["cruciform-petsc", "--help"]
