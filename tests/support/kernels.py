# SPDX-License-Identifier: MIT
"""What tests of kernels share: rotations, and differences against exact gradients."""

import numpy as np

DEGREE = np.pi / 180


def rotation(angle, axis=None):
    """In the plane, or in space about an axis (Rodrigues)."""
    if axis is None:
        return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def differences(function, x, step):
    """Central differences of function(x) (n, ...) by the points x (n, k, dim): (n, ..., k, dim)."""
    columns = []
    for p in range(x.shape[1]):
        for i in range(x.shape[2]):
            ahead, behind = x.copy(), x.copy()
            ahead[:, p, i] += step
            behind[:, p, i] -= step
            columns.append((function(ahead) - function(behind)) / (2 * step))
    return np.stack(columns, axis=-1).reshape(*columns[0].shape, *x.shape[1:])


def is_gradient(of, exact, x, step, tolerance):
    """Differences against the exact gradient, relative to the largest entry of each element."""
    found = differences(of, x, step)
    size = abs(exact).reshape(len(exact), -1).max(axis=1)
    error = abs(found - exact).reshape(len(exact), -1).max(axis=1) / size
    assert error.max() < tolerance, f"{error.max():.2g} at {error.argmax()}"
