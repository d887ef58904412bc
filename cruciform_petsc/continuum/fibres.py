# SPDX-License-Identifier: MIT
r"""Fibres of a membrane at finite deformation: what they measure, and the energy it costs.

With F = I + grad u and yarn directions d_w, d_e at rest, at right angles, the energy per area is

    W = Phi_w(e_w) + Phi_e(e_e) + c12 e_w e_e + psi(gamma)   or   w(e_w, e_e) + psi(gamma)
    lambda = |F d|,  e = Fabric.effective_strain(lambda)
    gamma = 90 deg - angle(F d_w, F d_e) = theta_w - theta_e + 90 deg

theta being the direction angle of F d. With yarn bending there is besides, per area,
D_w kappa_w^2/2 + D_e kappa_e^2/2, where kappa is d(theta)/ds along the yarn at rest and D the
yarns' flexural rigidity times their number per length. Lagrange elements have kinks across facets,
so its energy is that of C0 interior penalty (Engel et al. 2002, doi 10.1016/S0045-7825(02)00286-4,
for beams and plates): with the kink j = [theta] (n . d) of a fibre that passes a facet,

    E_b = sum over yarns of  int_cells D kappa^2/2  +  int_facets D {kappa} j + eta D/h j^2/2

A clamped edge holds the direction of the fibres in the same way.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import ufl

# Moduli that the convex tangent keeps at least, in parts of those at rest.
CONVEX_FLOOR = 0.05


def measures(u: Any, directions: Sequence[Any]) -> Any:
    """Stretches of warp and weft and the shear angle of a displacement, as a UFL vector."""
    return fibre_measures(*(d + ufl.grad(u) * d for d in directions))


def fibre_measures(warp: Any, weft: Any) -> Any:
    """The same of the fibres F d, in the plane or in space; there angles are within 90 degrees."""
    across = _cross(warp, weft)
    if len(warp) == 3:
        across = ufl.sqrt(ufl.inner(ufl.cross(warp, weft), ufl.cross(warp, weft)))
    shear = ufl.atan2(ufl.dot(warp, weft), across)
    return ufl.as_vector((ufl.sqrt(ufl.dot(warp, warp)), ufl.sqrt(ufl.dot(weft, weft)), shear))


def bending_energy(
    u: Any, direction: Any, rigidity: Any, degree: int, dx: Any, edges: Sequence[tuple[Any, Any]]
) -> Any:
    """Energy of one family's bending in the plane, as a UFL form.

    Parameters
    ----------
    u : displacement, of elements of a degree of 2 or more
    direction, rigidity
        Of the family at rest; D in N m.
    degree : int
    dx : integration measure of the triangles
    edges : sequence of (direction, measure)
        Direction in which clamps hold the fibres, and the clamped edge's measure.
    """
    # Bound of a polynomial of degree p - 2 on a side by that in its triangle (Warburton and
    # Hesthaven 2003, doi 10.1016/S0045-7825(03)00294-9) times |side|/|triangle|; then 4 where
    # 3/2 would do for three equal sides, as neighbours may be twice as small.
    mesh = dx.ufl_domain()
    bound = max(degree * (degree - 1) / 2, 1.0)
    penalty = 4.0 * bound * ufl.FacetArea(mesh) / ufl.CellVolume(mesh)
    quadrature = {"quadrature_degree": 2 * degree - 2}
    n = ufl.FacetNormal(mesh)
    along = ufl.grad(u) * direction
    a = direction + along
    kappa = _cross(a, ufl.grad(along) * direction) / ufl.dot(a, a)

    def facets(kappa: Any, before: Any, after: Any, n: Any, eta: Any) -> Any:
        kink = ufl.atan2(_cross(before, after), ufl.dot(before, after)) * ufl.dot(n, direction)
        return kappa * kink + 0.5 * eta * kink**2

    inner = facets(ufl.avg(kappa), a("+"), a("-"), n("+"), ufl.avg(penalty))
    energy = 0.5 * kappa**2 * dx + inner * ufl.dS(mesh, metadata=quadrature)
    for held, ds in edges:  # kappa is of one side only, so twice the penalty
        energy += facets(kappa, a, held, n, 2.0 * penalty) * ds(metadata=quadrature)
    return rigidity * energy


def resultants(fabric: Any, measures: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Energy, stress and moduli of a fabric at given stretches and shear angles.

    Parameters
    ----------
    fabric : Fabric
    measures : float (..., 3)
        lambda_w, lambda_e, gamma (radians).

    Returns
    -------
    energy : float (..., 2), of tension and of shear, J/m^2
    stress : float (..., 3), derivatives with respect to the measures, N/m
    moduli : float (..., 4), second derivatives: ww, ee, gamma gamma, we, N/m
    """
    tension, stress, moduli = fabric.tension(measures[..., :2])
    shear, torque, modulus = fabric.shear.evaluate(measures[..., 2])
    return (
        np.stack([tension, shear], axis=-1),
        np.concatenate([stress, torque[..., None]], axis=-1),
        np.stack([moduli[..., 0], moduli[..., 1], modulus, moduli[..., 2]], axis=-1),
    )


def times(moduli: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Change (..., 3) of the stress with that of the measures, by moduli (..., 4)."""
    result = moduli[..., :3] * change
    result[..., :2] += moduli[..., 3:] * change[..., 1::-1]
    return result


def convex_part(
    fabric: Any, stress: np.ndarray, moduli: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Stress and moduli without what can make the tangent indefinite: shapes as of resultants."""
    rest = resultants(fabric, np.array([1.0, 1.0, 0.0]))[2]
    convex = np.maximum(moduli, CONVEX_FLOOR * rest)
    bad = moduli[..., 3] ** 2 >= 0.999 * convex[..., 0] * convex[..., 1]
    convex[..., 3] = np.where(bad, 0.0, moduli[..., 3])
    return np.maximum(stress, 0.0) * (1.0, 1.0, 0.0), convex


def _cross(a: Any, b: Any) -> Any:
    return a[0] * b[1] - a[1] * b[0]
