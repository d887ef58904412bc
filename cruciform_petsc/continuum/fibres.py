# SPDX-License-Identifier: MIT
r"""Fibres of a membrane at finite deformation: what they measure, and the energy it costs.

With F = I + grad u and yarn directions d_w, d_e at rest, at right angles, the energy per area is

    W = Phi_w(e_w) + Phi_e(e_e) + c12 e_w e_e + psi(gamma)
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
    warp, weft = (d + ufl.grad(u) * d for d in directions)
    shear = ufl.atan2(ufl.dot(warp, weft), _cross(warp, weft))
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
    p = degree
    # Bound of a polynomial of degree p - 2 on a side by that in its triangle (Warburton and
    # Hesthaven 2003, doi 10.1016/S0045-7825(03)00294-9) times |side|/|triangle|; then 4 where
    # 3/2 would do for three equal sides, as neighbours may be twice as small.
    mesh = dx.ufl_domain()
    penalty = 4.0 * max(p * (p - 1) / 2, 1.0) * ufl.FacetArea(mesh) / ufl.CellVolume(mesh)
    quadrature = {"quadrature_degree": 2 * p - 2}
    n = ufl.FacetNormal(mesh)
    along = ufl.grad(u) * direction
    a = direction + along
    kappa = ufl.dot(_perp(a), ufl.grad(along) * direction) / ufl.dot(a, a)
    energy = 0.5 * kappa**2 * dx

    def facets(kappa: Any, before: Any, after: Any, n: Any, eta: Any) -> Any:
        kink = ufl.atan2(_cross(before, after), ufl.dot(before, after)) * ufl.dot(n, direction)
        return kappa * kink + 0.5 * eta * kink**2

    inner = facets(ufl.avg(kappa), a("+"), a("-"), n("+"), ufl.avg(penalty))
    energy += inner * ufl.dS(mesh, metadata=quadrature)
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
    moduli : float (..., 4), second derivatives: ww, ee, we, gamma gamma, N/m
    """
    a, a1, a2 = fabric.effective_strain(measures[..., 0])
    b, b1, b2 = fabric.effective_strain(measures[..., 1])
    c12 = float(fabric.c12)
    wa, wa1, wa2 = fabric.warp_tension.evaluate(a)
    wb, wb1, wb2 = fabric.weft_tension.evaluate(b)
    shear, tau, shear_modulus = fabric.shear.evaluate(measures[..., 2])
    pull_a, pull_b = wa1 + c12 * b, wb1 + c12 * a
    stiff_a, stiff_b = wa2 * a1**2 + pull_a * a2, wb2 * b1**2 + pull_b * b2
    return (
        np.stack([wa + wb + c12 * a * b, shear], axis=-1),
        np.stack([pull_a * a1, pull_b * b1, tau], axis=-1),
        np.stack([stiff_a, stiff_b, c12 * a1 * b1, shear_modulus], axis=-1),
    )


def times(moduli: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Change (..., 3) of the stress with that of the measures, by moduli (..., 4)."""
    warp, weft, shear = np.moveaxis(change, -1, 0)
    c = moduli
    return np.stack(
        [
            c[..., 0] * warp + c[..., 2] * weft,
            c[..., 1] * weft + c[..., 2] * warp,
            c[..., 3] * shear,
        ],
        axis=-1,
    )


def convex_part(
    fabric: Any, stress: np.ndarray, moduli: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Stress and moduli without what can make the tangent indefinite: shapes as of resultants."""
    stress = np.maximum(stress, 0.0) * (1.0, 1.0, 0.0)
    rest = resultants(fabric, np.array([1.0, 1.0, 0.0]))[2]
    stiff = [0, 1, 3]
    moduli = moduli.copy()
    moduli[..., stiff] = np.maximum(moduli[..., stiff], CONVEX_FLOOR * rest[stiff])
    bad = moduli[..., 2] ** 2 >= 0.999 * moduli[..., 0] * moduli[..., 1]
    moduli[bad, 2] = 0.0
    return stress, moduli


def _perp(a: Any) -> Any:
    """Turn a vector anticlockwise by 90 degrees."""
    return ufl.as_vector((-a[1], a[0]))


def _cross(a: Any, b: Any) -> Any:
    return a[0] * b[1] - a[1] * b[0]
