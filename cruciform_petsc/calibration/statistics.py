# SPDX-License-Identifier: MIT
"""What the data of a regularised least-squares problem tell of its parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Estimate:
    """Errors of the parameters at the least of |r|^2 + |B p|^2."""

    noise: float  # standard deviation of the data
    errors: np.ndarray  # (m,) standard errors of the parameters
    settled: float  # how many parameters the data settle; the others come from the second term
    singular_values: np.ndarray  # (m,) of the data's derivatives, the largest first


def estimate(
    residuals: np.ndarray, data: np.ndarray, prior: np.ndarray, least_noise: float = 0.0
) -> Estimate:
    """Errors of parameters, from the covariance noise^2 (J'J + B'B)^-1.

    noise^2 = |r|^2/(n - settled) with settled = trace(J (J'J + B'B)^-1 J'), the effective number of
    parameters (Hastie, Tibshirani and Friedman 2009, The Elements of Statistical Learning, sections
    3.2 and 3.4.1); without B that is the m of ordinary least squares.

    Parameters
    ----------
    residuals : float (n,)
        r, all of one standard deviation.
    data, prior : float (n, m), (k, m)
        J, derivatives of the residuals; and B.
    least_noise : float
        Data are no better than that, however well they are met.
    """
    inverse = np.linalg.pinv(data.T @ data + prior.T @ prior, hermitian=True)
    settled = float(np.trace(inverse @ data.T @ data))
    free = max(len(data) - settled, 1.0)
    noise = max(float(np.sqrt(residuals @ residuals / free)), least_noise)
    singular = np.zeros(data.shape[1])
    found = np.linalg.svd(data, compute_uv=False)
    singular[: len(found)] = found
    errors = noise * np.sqrt(np.maximum(np.diag(inverse), 0.0))
    return Estimate(noise, errors, settled, singular)
