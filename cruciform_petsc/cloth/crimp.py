# SPDX-License-Identifier: MIT
"""Crimp model of a plain weave: yarns as a sawtooth, which trade crimp for crimp.

Geometry and balance of forces as of Kawabata, Niwa and Kawai 1973 (J. Text. Inst. 64:21, biaxial
deformation of plain weaves; the sawtooth with extensible yarns is that of Chicurel and Suppiger,
Text. Res. J. 1960, 1964), found as a least energy as by Ramgulam and Potluri 2004, with the bending
of Leaf and Kandil 1980 (J. Text. Inst. 71:1) so that cloth that nothing pulls has a shape. From
crossover to crossover a yarn is straight and rises by its crimp height h over a length p of the
cloth, which the cloth's strain stretches:

    l = sqrt((p (1 + e))^2 + h^2),   l_0 = sqrt(p^2 + h_0^2),   h_0w + h_0e = D at rest
    U = sum over warp and weft of  [ EA l_0 (l/l_0 - 1)^2/2 + 6 B/(l_0 p^2) (h - h_0)^2 ]
        + Psi((D - h_w - h_e)/2)                 Psi: flattening of the yarns where they cross
    w(e_w, e_e) = least U over h_w, h_e, divided by p_w p_e

Axes lie half a crimp height above and below the middle where they cross, so that the sum of the
heights is twice the distance of the axes. Limp yarns are pressed together by Psi' = 2 F sin(theta),
from both sides. The derivatives of w are the tensions per width, T_w = F_w cos(theta_w)/p_e with
F = EA (l/l_0 - 1) and tan(theta) = h/(p (1 + e)). So there is a potential by construction; and as l
is a convex function of (e, h), w is convex wherever neither yarn is pressed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..laws import Potential
from ..tension import CRIMP, BiaxialLaw


@dataclass(frozen=True)
class Crimp:
    """A plain weave's crossover, in SI; pairs are of warp and weft."""

    pitch: tuple[float, float]
    """Length of the cloth from crossover to crossover, along the warp and along the weft [m]."""
    height: tuple[float, float]
    """Crimp height: how far a yarn's axis rises from one crossover to the next [m]."""
    stiffness: tuple[float, float]
    """Force over strain of one yarn, EA [N]."""
    bending: tuple[float, float]
    """Flexural rigidity of one yarn out of the cloth's plane, B [N m^2]."""
    contact: Potential
    """Force between the yarns at a crossover [N] over how much closer their axes are there [m]."""

    @property
    def crimp(self) -> np.ndarray:
        """Length of a yarn over that of the cloth, less one; (2,)."""
        return np.hypot(1.0, np.divide(self.height, self.pitch)) - 1.0

    @property
    def law(self) -> BiaxialLaw:
        """The law of both tensions."""
        pitch, height = np.array(self.pitch), np.array(self.height)
        # Beams between crossovers, where by symmetry they do not turn: 12 B/(l p^2) makes of the
        # modulus of inextensible yarns at rest that of Leaf and Kandil (uniaxial_modulus).
        spring = 12.0 * np.array(self.bending) / (np.hypot(pitch, height) * pitch**2)
        numbers = (*pitch, *height, *self.stiffness, *spring, *self.contact.data)
        return BiaxialLaw((CRIMP, *(float(number) for number in numbers)))


def uniaxial_modulus(crimp: Crimp) -> tuple[float, float]:
    """Moduli [N/m] of a cloth whose yarns neither stretch nor flatten, pulled in one direction.

    Leaf and Kandil 1980, with lengths l and crimp angles theta at rest:

    E_1 = 12 B_1 p_1/(p_2 l_1^3 sin^2 theta_1)
          [1 + B_2 l_1^3 cos^2 theta_1/(B_1 l_2^3 cos^2 theta_2)]
    """
    p, h, b = (np.array(pair) for pair in (crimp.pitch, crimp.height, crimp.bending))
    length = np.hypot(p, h)
    sine, cosine = h / length, p / length
    own = 12.0 * b / length**3 / cosine**2  # per height
    return tuple(
        float((own[0] + own[1]) * cosine[i] ** 2 * p[i] / (p[1 - i] * sine[i] ** 2)) for i in (0, 1)
    )  # type: ignore[return-value]


def interchange(crimp: Crimp, warp: float) -> float:
    """Weft strain of a cloth whose yarns neither stretch nor flatten, at a warp strain.

    From l_i = l_0i and h_w + h_e = D: crimp leaves the warp and goes to the weft, until the warp is
    straight (warp strain = its crimp). NaN beyond.
    """
    (p1, p2), (h1, h2) = crimp.pitch, crimp.height
    left = p1**2 + h1**2 - (p1 * (1.0 + warp)) ** 2
    height = h1 + h2 - np.sqrt(left) if left >= 0.0 else np.nan
    return float(np.sqrt(p2**2 + h2**2 - height**2) / p2 - 1.0)
