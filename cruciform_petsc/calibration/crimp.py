# SPDX-License-Identifier: MIT
"""The crimp model of a cloth from its measured tensions at several ratios of the strains.

Known are the yarns per length, the yarns' bending, of which tensions tell nothing, and where to
start from. Sought are logarithms of what is positive: stiffness of both yarns, how many times the
start's the force at a crossover is, and the crimp heights if they were not measured, so that the
mean square of the tensions' misfit is least, by SciPy's trust region.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..cloth.crimp import Crimp
from ..cloth.surface import check_points
from ..errors import InputError

NAMES = (
    "warp_stiffness", "weft_stiffness", "crossover", "warp_height", "weft_height",
)  # fmt: skip
HEIGHTS = 3  # from there on
UNKNOWN = 0.2  # relative standard error from which on a value is not settled by the points
REACH = 1e4  # times more or less than the start


@dataclass(frozen=True)
class CrimpFit:
    """A crimp model found from points."""

    crimp: Crimp
    start: Crimp
    points: np.ndarray
    """Strains and tensions [N/m] of warp and weft, (n, 4)."""
    fitted: np.ndarray
    """Tensions of the model there, (n, 2)."""
    errors: dict[str, float]
    """Relative standard errors by name, of what was sought."""
    evaluations: int

    @property
    def misfit(self) -> float:
        """RMS of the model's tensions less the points', over the RMS of the points'."""
        return _misfit(self.fitted, self.points)

    @property
    def start_misfit(self) -> float:
        """The same of the start."""
        return _misfit(_tensions(self.start, self.points), self.points)

    @property
    def unknown(self) -> list[str]:
        """Names of what the points do not settle."""
        return [name for name, error in self.errors.items() if not error < UNKNOWN]


def fit_crimp(points: np.ndarray, start: Crimp, heights: bool = False) -> CrimpFit:
    """Find the crimp model that is nearest to measured tensions.

    Parameters
    ----------
    points : float (n, 4)
        As for `cloth.surface.fit_surface`.
    start : Crimp
    heights : bool
        Whether the crimp heights are sought, too, and not as they were measured.

    Raises InputError for the points as fit_surface does, and where they are too few.
    """
    from scipy.optimize import least_squares

    points = np.asarray(points, float)
    check_points(points)
    names = NAMES if heights else NAMES[:HEIGHTS]
    tension = points[:, 2:]
    if tension.size <= len(names):
        raise InputError(f"{len(names)} values cannot be found from {len(points)} points")
    size = np.sqrt(np.mean(tension**2))

    def model(logs: np.ndarray) -> Crimp:
        factor = np.exp(np.append(logs, np.zeros(len(NAMES) - len(logs)))).tolist()
        return replace(
            start,
            stiffness=(start.stiffness[0] * factor[0], start.stiffness[1] * factor[1]),
            contact=start.contact.times(factor[2]),
            height=(start.height[0] * factor[3], start.height[1] * factor[4]),
        )

    def residuals(logs: np.ndarray) -> np.ndarray:
        return (_tensions(model(logs), points) - tension).ravel() / size

    limit = np.log(REACH)
    found = least_squares(
        residuals, np.zeros(len(names)), bounds=(-limit, limit), x_scale=0.3, xtol=1e-10,
        diff_step=1e-5, max_nfev=200,
    )  # fmt: skip
    variance = 2.0 * found.cost / (tension.size - len(names))
    # What no point tells has no end of an error.
    values, vectors = np.linalg.eigh(found.jac.T @ found.jac)
    spread = vectors**2 @ (1.0 / np.maximum(values, 1e-300))
    errors = np.sqrt(max(variance, 1e-12) * spread)
    crimp = model(found.x)
    return CrimpFit(
        crimp, start, points, _tensions(crimp, points),
        dict(zip(names, (float(error) for error in errors), strict=True)), int(found.nfev),
    )  # fmt: skip


def _tensions(crimp: Crimp, points: np.ndarray) -> np.ndarray:
    return crimp.law.evaluate(points[:, 0], points[:, 1])[1]


def _misfit(tension: np.ndarray, points: np.ndarray) -> float:
    return float(np.sqrt(np.mean((tension - points[:, 2:]) ** 2) / np.mean(points[:, 2:] ** 2)))
