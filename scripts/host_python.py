# SPDX-License-Identifier: MIT
"""Does the caller's python3 have FEniCSx?  scripts/fenicsx asks this, with python3 itself.

The exit code says it: 3, it has not, and the reason is printed; 4, it has but more is missing, and
the user has been told; 0, it has.  With 0, if modules were missing that pip can install, the bin
folder of a venv with them is printed, to be put first on PATH.  That venv stands on top of python3
and is made here, once, in the folder given as argument.
"""

import fcntl
import hashlib
import os
import shutil
import subprocess
import sys
import sysconfig
from importlib import import_module, metadata
from importlib.util import find_spec
from pathlib import Path

CORE = ("dolfinx", "petsc4py", "mpi4py")
NEEDED = ("numpy", "scipy", "pydantic", "pint", "shapely", "h5py", "vtk", "matplotlib", "rich")
NEEDED += ("gmsh", "jinja2", "numba", "pyvista", "pytest", "hypothesis")
PIP_NAMES = {"dolfinx": "fenics-dolfinx"}
MESSAGES = os.fdopen(3, "w")  # what the user reads; scripts/fenicsx gives away stderr
LEAST_MAJOR = {"pydantic": 2, "shapely": 2}


def no(reason):
    """Answer that python3 cannot be used."""
    print(reason)
    raise SystemExit(3)


def say(text):
    """Tell the user what goes on."""
    print("fenicsx:", text, file=MESSAGES, flush=True)


def present(name):
    """Whether a module can be imported; a folder without __init__ has no origin."""
    spec = find_spec(name)
    return spec is not None and spec.origin is not None


def installed_version(name):
    """Return the version of an importable module, and whether pip knows it."""
    try:
        return metadata.version(PIP_NAMES.get(name, name)), True
    except metadata.PackageNotFoundError:
        return import_module(name).__version__, False


def numbers(version):
    """Return (major, minor) of a version."""
    return tuple(int(part) for part in version.split(".")[:2])


def check_fenicsx():
    """Answer no unless FEniCSx is there and good."""
    if sys.version_info < (3, 11):  # noqa: UP036
        no("python3 is older than 3.11")
    for name in CORE:
        if not present(name):
            no(f"python3 has no {name}")
    # A process started by mpirun must not initialise MPI in place of CMD: nothing is imported.
    if {"OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PMI_RANK"} & set(os.environ):
        return
    try:
        import dolfinx
        import petsc4py
        from petsc4py import PETSc
    except Exception as error:
        no(f"python3 cannot import FEniCSx ({error})")
    if numbers(dolfinx.__version__) < (0, 9):
        no(f"python3 has dolfinx {dolfinx.__version__}, older than 0.9")
    if numbers(petsc4py.__version__) < (3, 22):
        no(f"python3 has petsc4py {petsc4py.__version__}, older than 3.22")
    if issubclass(PETSc.ScalarType, complex):
        no("python3 has a PETSc of complex numbers")
    for name in ("mumps", "hypre"):
        if not PETSc.Sys.hasExternalPackage(name):
            no(f"python3 has a PETSc without {name}")


def missing_requirements():
    """Return what pip has to install, as pip writes it."""
    missing = {}
    for name in NEEDED:
        least = LEAST_MAJOR.get(name)
        if not present(name) or (least and numbers(installed_version(name)[0])[0] < least):
            missing[name] = f"{name}>={least}" if least else name
    return missing


def make_venv(venv, missing, run):
    """Make a venv with all that python3 has, plus what is missing."""
    import site

    python = venv / "bin" / "python3"
    run(sys.executable, "-m", "venv", "--system-site-packages", venv)
    packages = Path(sysconfig.get_path("purelib", "venv", {"base": venv, "platbase": venv}))
    # What is there must stay as it is, even if pip would like another version of it, and even if
    # pip does not see it (Debian's vtk, for one, has no metadata: give it some).
    constraints = ""
    for name in CORE + NEEDED:
        if name in missing or not present(name):
            continue
        version, known_to_pip = installed_version(name)
        pip_name = PIP_NAMES.get(name, name)
        constraints += f"{pip_name}=={version}\n"
        if not known_to_pip:
            stub = packages / f"{pip_name.replace('-', '_')}-{version}.dist-info"
            stub.mkdir()
            text = f"Metadata-Version: 2.1\nName: {pip_name}\nVersion: {version}\n"
            (stub / "METADATA").write_text(text)
    (venv / "constraints.txt").write_text(constraints)
    # If python3 lives in a venv itself, its packages are not those that venv calls the system's.
    if sys.prefix != sys.base_prefix:
        lines = [f"import site; site.addsitedir({p!r})\n" for p in site.getsitepackages()]
        (packages / "parent_venv.pth").write_text("".join(lines))
    constrained = ["--constraint", venv / "constraints.txt"]
    run(python, "-m", "pip", "install", *constrained, *missing.values())
    for name in missing:
        trial = subprocess.run([python, "-c", f"import {name}"], capture_output=True, text=True)
        if trial.returncode != 0:  # gmsh, for one, wants system libraries
            error = trial.stderr.splitlines()[-1]
            say(f"{name} is installed now, but does not work before you mend this: {error}")


def venv_with(missing, cache):
    """Return the bin folder of the venv that has what is missing, made if need be."""
    key = "\n".join([sys.executable, sys.version, *missing.values()])
    venv = cache / ("venv-" + hashlib.sha256(key.encode()).hexdigest()[:8])
    ready = venv / "ready"  # written last: an interrupted venv lacks it
    if ready.exists():
        return venv / "bin"
    names = ", ".join(missing)
    cache.mkdir(parents=True, exist_ok=True)
    with open(venv.with_suffix(".lock"), "w") as lock, open(venv.with_suffix(".log"), "w+") as log:

        def run(*command):
            # pip keeps the lock even if this process is killed: nobody deletes its files then
            streams = {"stdin": subprocess.DEVNULL, "stdout": log, "stderr": log}
            command = [str(part) for part in command]
            subprocess.run(command, check=True, pass_fds=[lock.fileno()], **streams)

        fcntl.flock(lock, fcntl.LOCK_EX)
        if ready.exists():
            return venv / "bin"
        say(f"python3 has FEniCSx but not {names}: installing that into {venv}, once (a minute)")
        shutil.rmtree(venv, ignore_errors=True)
        try:
            make_venv(venv, missing, run)
        except (OSError, subprocess.CalledProcessError) as error:
            shutil.rmtree(venv, ignore_errors=True)
            log.seek(0)
            print(*log.read().splitlines()[-5:], error, sep="\n", file=MESSAGES)
            say(f"installing {names} failed ({log.name}); please install that for {sys.executable}")
            raise SystemExit(4) from None
        ready.touch()
    return venv / "bin"


if __name__ == "__main__":
    check_fenicsx()
    missing_names = missing_requirements()
    if missing_names:
        print(venv_with(missing_names, Path(sys.argv[1])))
