# SPDX-License-Identifier: MIT
"""Cloths whose drape was measured: Matsudaira et al. 2015, J. Textile Eng. 61:69, Tables 1, 2."""

from typing import NamedTuple

GF = 9.80665e-3  # N
SLIPS = 0.1  # 1/cm: over which friction between yarns comes to its full moment


class Measured(NamedTuple):
    """By KES and a drape meter.

    Bending rigidity [gf cm^2/cm], hysteresis of the moment [gf cm/cm], mass [mg/cm^2], thickness
    [mm]; drape coefficient [%], number of folds.
    """

    bending: float
    hysteresis: float
    mass: float
    thickness: float
    coefficient: float
    folds: int


CLOTHS = {
    "cotton broad": Measured(0.118, 0.124, 12.38, 0.497, 82.9, 2),
    "wool tropical": Measured(0.067, 0.033, 16.29, 0.407, 49.8, 5),
    "polyester tropical": Measured(0.077, 0.029, 11.65, 0.340, 50.7, 5),
    "polyester faille": Measured(0.019, 0.007, 10.43, 0.226, 28.3, 7),
}


def fabric(name):
    """[fabric] of a case, in TOML.

    The moment rises by half of the hysteresis over SLIPS, and with the rigidity beyond; twisting is
    that of a sheet that bends alike in all directions, shear 0.5 gf/cm/deg, both assumed.
    """
    cloth = CLOTHS[name]
    half = 0.5 * cloth.hysteresis
    points = []
    for share in (0.25, 0.5, 1.0, 2.0, 10.0, 30.0):
        curvature = share * SLIPS
        slid = 1.0 - 2.718281828 ** (-2.0 * share)
        moment = GF * (half * slid + cloth.bending * curvature)  # N m/m, N mm/mm
        points.append([curvature, float(f"{moment:.5g}")])
    law = f'{{ law = "table", curvature = "1/cm", moment = "N mm/mm", points = {points} }}'
    yarn = '{ modulus = "50 N/cm", poisson = 0, yarns = "2 /cm", yarn_bending = "0.005 N mm^2", '
    yarn += f"out_of_plane_moment = {law} }}"
    return f"""
[fabric]
warp = {yarn}
weft = {yarn}
shear = {{ modulus = "0.5 gf/cm/deg" }}
tension = {{ strain = "log", compression = 0.02 }}
out_of_plane_twisting = 1.0
thickness = "{cloth.thickness} mm"
areal_density = "{10 * cloth.mass:.5g} g/m^2"
"""
