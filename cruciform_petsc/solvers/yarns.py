# SPDX-License-Identifier: MIT
"""Smoother of the yarn multigrid: the yarns of one family are solved whole, then the other's.

An arm end shares cruciforms with its own yarn and with crossing yarns only, so the unknowns of all
warp yarns fall apart into single yarns, and so do those of all weft yarns: with A_11 and A_22 the
two families' own blocks, block Gauss-Seidel between the families costs little more than a product
with the matrix, and it takes the stiff direction, along the yarns, out of the problem.

With the warp always in equilibrium, what is left is a system for the weft, whose yarns are solved
by its block diagonal: eigenvalues lie between 0 and 1. Where bending reaches further than a pitch,
neighbouring yarns that move along themselves to and fro over four pitches, which no coarse grid
shows, have a tenth. Therefore the weft goes further than to its equilibrium, by the roots of
Chebyshev's polynomial, as smoothers of PETSc's do (Adams, Brezina, Hu and Tuminaro 2003, J. Comput.
Phys. 188:593). Sweeps up go the way of those down back, so that the cycle is symmetric.

A yarn's end on the outline belongs to both families: where a tail is short, the crossing yarn hangs
on it as stiffly as on its own next arm end. Couplings between different yarns of one family, if a
matrix has any, are left out and their size is added to the diagonal, which keeps what is left
positive definite.

Across ranks a yarn is cut at the arm ends between two ranks (*joints*, owned by the lower one): the
pieces are eliminated on their ranks, the joints' Schur complement, one small block each, is
summed up by its owner. This is exact for yarns that run over two ranks. Over more, the coupling of
one joint to the next through a whole piece is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy.sparse import csr_array, tril

from ..errors import SolverError
from ..parallel import Halo
from .callbacks import callback
from .csr import local_rows

# The factors and couplings of the smoother are kept in single precision. Rounding them is the same
# for both halves of a symmetric pair, and what it changes is one of many ways to precondition;
# residuals are taken with the matrix itself.
_REAL = np.float32
# Indices without sign spare the compiled loops a test of each for being negative: twice as fast.
_INDEX = np.uint32
# Neighbouring yarns that are solved alternately: the substitutions of one yarn depend each on the
# last, those of several fill the processor.
_GROUP = 4
# Least eigenvalue, of a largest one of 1, that sweeps make the most of. Iterations at 10^4
# crossovers, Table 1, change by one between 0.2 and 0.4.
_LEAST = 0.3
_OTHER, _BEYOND = -1, -2  # see _split


@dataclass
class OnYarns:
    """On which yarns the unknowns of a rank lie."""

    # int32 (n, 2), number of the warp and of the weft yarn that each belongs to, -1 for none. All
    # belong to one, those of ends on the outline to two.
    line: np.ndarray
    place: np.ndarray  # float (n, 2), where on these yarns; ascending along them
    # bool (n,), where yarns are cut between ranks: arm ends. By default everywhere. Couplings
    # across a cut that pass a joint by are left out, as those between yarns are.
    joint: np.ndarray | None = None


def steps(sweeps: int) -> list[tuple[int, float]]:
    """Families to be solved one after the other, and how far each goes: 1 is to equilibrium."""
    root = np.cos((np.arange(sweeps) + 0.5) * np.pi / sweeps)[::-1]
    further = 2.0 / (1.0 + _LEAST + (1.0 - _LEAST) * root)
    return [step for weight in further for step in ((0, 1.0), (1, float(weight)))] + [(0, 1.0)]


# -- kernels -----------------------------------------------------------------------------------


@numba.njit(cache=True)
def _split(rows, num_inner, num_with_outer, position, line, pointer, column, value, outer_column,
           outer_value):  # fmt: skip
    """Lower triangle within the yarns, and couplings to the other family, of some rows.

    position (n_local,): place in the order of elimination; _OTHER in the other family, _BEYOND for
    what no one here knows. Rows from ``num_inner`` on are joints, those from ``num_with_outer`` on
    have no couplings to the other family. What couplings to other yarns of the family have been
    adds to the diagonal. Returns pointers of the two (rows + 1,), columns and values of the first;
    those of the second are written to ``outer_column``, ``outer_value``.
    """
    n = len(rows)
    inner, outer = np.zeros(n + 1, np.int64), np.zeros(n + 1, np.int64)
    size = 0
    for k in range(n):
        size += (pointer[rows[k] + 1] - pointer[rows[k]] + 1) // 2 + 1
    inner_column, inner_value = np.empty(2 * size, np.int32), np.empty(2 * size)
    i, o = 0, 0
    for k in range(n):
        r = rows[k]
        extra, diagonal = 0.0, -1
        for e in range(pointer[r], pointer[r + 1]):
            c = column[e]
            p = position[c]
            if value[e] == 0.0:
                continue
            if p == _BEYOND:
                if k < num_inner:  # at joints the other rank sees to it
                    extra += abs(value[e])
                continue
            if p == _OTHER:
                if k < num_with_outer:
                    outer_column[o] = c
                    outer_value[o] = value[e]
                    o += 1
            elif line[c] != line[r]:
                extra += abs(value[e])
            elif p <= k:
                inner_column[i] = p
                inner_value[i] = value[e]
                if p == k:
                    diagonal = i
                i += 1
        if diagonal >= 0:
            inner_value[diagonal] += extra
        inner[k + 1], outer[k + 1] = i, o
    return inner, outer, inner_column[:i], inner_value[:i]


@numba.njit(cache=True)
def _elimination_tree(n, pointer, column):
    """Parents in the elimination tree of a symmetric matrix, lower triangle by rows (n,).

    Liu 1990, SIAM J. Matrix Anal. Appl. 11:134, algorithm 4.2; with it goes the up-looking Cholesky
    factorisation of Davis 2006, Direct Methods for Sparse Linear Systems, section 4.7.
    """
    parent, ancestor = np.full(n, -1, np.int32), np.full(n, -1, np.int32)
    for k in range(n):
        for e in range(pointer[k], pointer[k + 1]):
            i = column[e]
            while i != -1 and i < k:
                up = ancestor[i]
                ancestor[i] = k
                if up == -1:
                    parent[i] = k
                i = up
    return parent


@numba.njit(cache=True)
def _reach(k, pointer, column, n, parent, mark, found):
    """Columns below n of row k of the factor; returns how many, ascending in ``found``."""
    count = 0
    for e in range(pointer[k], pointer[k + 1]):
        i = column[e]
        if i >= n:
            continue
        while i != -1 and i < n and mark[i] != k and i != k:
            mark[i] = k
            found[count] = i
            count += 1
            i = parent[i]
    for a in range(1, count):  # they come nearly in order
        value, b = found[a], a
        while b > 0 and found[b - 1] > value:
            found[b] = found[b - 1]
            b -= 1
        found[b] = value
    return count


@numba.njit(cache=True)
def _factor_pattern(n, pointer, column, parent):
    """Row lengths of the factor's strict lower triangle; rows from n on reach columns below n."""
    rows = len(pointer) - 1
    mark, found = np.full(max(rows, 1), -1, np.int32), np.empty(max(rows, 1), np.int32)
    lengths = np.zeros(rows + 1, np.int64)
    for k in range(rows):
        lengths[k + 1] = _reach(k, pointer, column, n, parent, mark, found)
    return np.cumsum(lengths)


@numba.njit(cache=True)
def _factor(n, pointer, column, value, parent, start, factor_column, factor, inverse):
    """Cholesky factor by rows: strict lower triangle, and the inverse of the diagonal (n,).

    Rows from n on are those of L with A = [L11 0; L21 .]: no diagonal of their own.
    Returns the number of pivots that were not positive; these are replaced.
    """
    rows = len(pointer) - 1
    mark, found = np.full(max(rows, 1), -1, np.int32), np.empty(max(rows, 1), np.int32)
    x = np.zeros(max(n, 1))
    bad = 0
    for k in range(rows):
        count = _reach(k, pointer, column, n, parent, mark, found)
        diagonal = 0.0
        for e in range(pointer[k], pointer[k + 1]):
            if column[e] < n and column[e] != k:
                x[column[e]] += value[e]
            elif column[e] == k:
                diagonal += value[e]
        size = abs(diagonal)
        for a in range(count):
            j = found[a]
            total = x[j]
            for e in range(start[j], start[j + 1]):
                total -= factor[e] * x[factor_column[e]]
            total *= inverse[j]
            x[j] = total
            factor_column[start[k] + a] = j
            factor[start[k] + a] = total
            diagonal -= total * total
        for a in range(count):
            x[found[a]] = 0.0
        if k < n:
            if not diagonal > 1e-14 * size:
                bad += 1
                diagonal = size if size > 0 else 1.0
            inverse[k] = 1.0 / np.sqrt(diagonal)
    return bad


@numba.njit(cache=True, fastmath={"contract"})
def _load(begin, end, rows, outer, outer_column, outer_value, b, x, y):
    """Give y = b - C x: load on some rows without those of the other family."""
    for k in range(begin, end):
        other = 0.0
        for e in range(outer[k], outer[k + 1]):
            other += outer_value[e] * x[outer_column[e]]
        y[k] = b[rows[k]] - other


@numba.njit(cache=True, fastmath={"contract"})
def _load_of_threes(begin, end, rows, outer, outer_column, outer_value, b, x, y):
    """The same where nodes have three unknowns, C by blocks: columns are those of their first."""
    one, two, three = np.uint32(1), np.uint32(2), np.uint32(3)
    at = begin
    for k in range(begin // three, end // three):
        f, g, h = 0.0, 0.0, 0.0
        for e in range(outer[k], outer[k + 1]):
            c, q = outer_column[e], np.uint32(9) * e
            u, v, w = x[c], x[c + one], x[c + two]
            f += outer_value[q] * u + outer_value[q + one] * v + outer_value[q + two] * w
            q += three
            g += outer_value[q] * u + outer_value[q + one] * v + outer_value[q + two] * w
            q += three
            h += outer_value[q] * u + outer_value[q + one] * v + outer_value[q + two] * w
        r = rows[at]
        y[at], y[at + one], y[at + two] = b[r] - f, b[r + one] - g, b[r + two] - h
        at += three


@numba.njit(cache=True, fastmath={"contract"})
def _forward(begin, end, start, factor_column, factor, inverse, y):
    """Put L^-1 y in place of y."""
    for k in range(begin, end):
        total = y[k]
        for e in range(start[k], start[k + 1]):
            total -= factor[e] * y[factor_column[e]]
        y[k] = total * inverse[k]


@numba.njit(cache=True, fastmath={"contract"})
def _backward(begin, end, rows, start, factor_column, factor, inverse, x, y, weight):
    """Move x by ``weight`` of the way to L^-T y; y is used up."""
    k = end
    while k > begin:
        k -= np.uint32(1)
        value = y[k] * inverse[k]
        x[rows[k]] += weight * (value - x[rows[k]])
        for e in range(start[k], start[k + 1]):
            y[factor_column[e]] -= factor[e] * value


@numba.njit(cache=True)
def _solve(groups, threes, first, down, up, rows, outer, outer_column, outer_value,
           start, factor_column, factor, inverse, b, x, y, weight):  # fmt: skip
    """Load and elimination (down), and substitution back (up).

    Group after group of yarns, so that factors are in the cache when they are read again.
    """
    for g in range(len(groups) - 1):
        begin, end = groups[g], groups[g + 1]
        if down:
            if first:
                for k in range(begin, end):
                    y[k] = b[rows[k]]
            elif threes:
                _load_of_threes(begin, end, rows, outer, outer_column, outer_value, b, x, y)
            else:
                _load(begin, end, rows, outer, outer_column, outer_value, b, x, y)
            _forward(begin, end, start, factor_column, factor, inverse, y)
        if up:
            _backward(begin, end, rows, start, factor_column, factor, inverse, x, y, weight)


@numba.njit(cache=True)
def _threes(nodes, outer, outer_column, outer_value, blocks, block_column, block_value):
    """Blocks of three by three of the rows of some nodes; returns how many."""
    size = 0
    for k in range(nodes):
        begin = size
        for row in range(3):
            for e in range(outer[3 * k + row], outer[3 * k + row + 1]):
                c = outer_column[e] // 3 * 3
                at = begin
                while at < size and block_column[at] != c:
                    at += 1
                if at == size:
                    block_column[at] = c
                    block_value[9 * at : 9 * at + 9] = 0.0
                    size += 1
                block_value[9 * at + 3 * row + outer_column[e] - c] += outer_value[e]
        blocks[k + 1] = size
    return size


@numba.njit(cache=True)
def _merge(pointer, column, value, ghost_pointer, ghost_column, ghost_value, num_ghost):
    """Rows of own unknowns with both halves in one, then ghosts' rows: their own columns only."""
    n = len(pointer) - 1
    start = np.zeros(n + num_ghost + 1, np.int64)
    for r in range(n):
        start[r + 1] = pointer[r + 1] - pointer[r] + ghost_pointer[r + 1] - ghost_pointer[r]
    for e in range(len(ghost_column)):
        start[n + ghost_column[e] + 1] += 1
    start = np.cumsum(start)
    at = start[n:-1].copy()
    columns, values = np.empty(start[-1], np.int32), np.empty(start[-1])
    for r in range(n):
        k = start[r]
        for e in range(pointer[r], pointer[r + 1]):
            columns[k], values[k] = column[e], value[e]
            k += 1
        for e in range(ghost_pointer[r], ghost_pointer[r + 1]):
            g = ghost_column[e]
            columns[k], values[k] = n + g, ghost_value[e]
            k += 1
            columns[at[g]], values[at[g]] = r, ghost_value[e]
            at[g] += 1
    return start, columns, values


# -- families and sweeps -----------------------------------------------------------------------


@dataclass
class _Local:
    """A rank's part of the matrix: own rows, and of the ghosts' rows the columns of its own.

    pointer, column, value: compressed rows over own unknowns, then ghosts; joint (n_local,).
    """

    pointer: np.ndarray
    column: np.ndarray
    value: np.ndarray
    halo: Halo
    block: int
    joint: np.ndarray


class _Family:
    """One family's yarns: their factors, and their couplings to the other family.

    line int32 (n_local,), the yarn of each unknown, -1 for none; place float (n_local,). If a
    joint's block is singular on this rank, ``schur`` is not finite.
    """

    def __init__(self, local: _Local, line: np.ndarray, place: np.ndarray):
        self.local = local
        d = local.block
        own, lower = _joints(local, line)
        # Nodes stay whole. Eliminate towards the joint that a yarn ends at: then nothing fills in.
        inner = line[: local.halo.num_owned : d] >= 0
        inner[own[::d] // d] = False
        nodes = np.flatnonzero(inner)
        at, along = line[nodes * d], place[nodes * d]
        descend = np.isin(at, line[lower]) & ~np.isin(at, line[own])
        along = np.where(descend, -along, along)
        order = np.lexsort((at, along, at // _GROUP))
        nodes, group = nodes[order], at[order] // _GROUP
        ends = np.flatnonzero(np.diff(group, append=-1)) + 1
        self.groups = (d * np.concatenate([[0], ends])).astype(_INDEX)
        inner_rows = _unknowns(nodes, d)
        self.joints = joints = np.concatenate([own, lower])
        rows, n = np.concatenate([inner_rows, joints]), len(inner_rows)
        position = np.where(line >= 0, _BEYOND, _OTHER).astype(np.int32)
        position[rows] = np.arange(len(rows))
        # As large as they could be; pages that are not written to take no memory.
        outer_column: np.ndarray = np.empty(len(local.column), np.int32)
        outer_value: np.ndarray = np.empty(len(local.column), _REAL)
        inside, outer, column, value = _split(
            rows, n, n + len(own), position, line, local.pointer, local.column, local.value,
            outer_column, outer_value,
        )  # fmt: skip
        outer_column, outer_value = outer_column[: outer[-1]], outer_value[: outer[-1]]
        parent = _elimination_tree(n, inside, column)
        start = _factor_pattern(n, inside, column, parent)
        factor_column, factor = np.empty(start[-1], np.int32), np.empty(start[-1])
        inverse = np.empty(n)
        # Pivots that are not positive are replaced: the smoother of an indefinite tangent.
        _factor(n, inside, column, value, parent, start, factor_column, factor, inverse)
        self.rows = inner_rows.astype(_INDEX)
        if d == 3:
            pointer = np.zeros(len(nodes) + 1, _INDEX)
            block_column: np.ndarray = np.empty(outer[n], _INDEX)
            block_value: np.ndarray = np.empty(9 * outer[n], _REAL)
            size = _threes(
                len(nodes), outer, outer_column, outer_value, pointer, block_column, block_value
            )
            self.outer = pointer, block_column[:size].copy(), block_value[: 9 * size].copy()
        else:
            self.outer = outer[: n + 1].astype(_INDEX), outer_column.astype(_INDEX), outer_value
        self.factor = (
            start.astype(_INDEX), factor_column.astype(_INDEX), factor.astype(_REAL),
            inverse.astype(_REAL),
        )  # fmt: skip
        self.y = np.empty(n)
        # Joints: what they hang on, and their Schur complement, summed up by the owner.
        self.joints_outer = _rows_from(n, outer, outer_column, outer_value, len(line))
        self.eliminated = _rows_from(n, start, factor_column, factor, n)
        lower = _rows_from(n, inside, column, value, len(rows))[:, n:]
        schur = (lower + tril(lower, -1).T - self.eliminated @ self.eliminated.T).tocoo()
        node = joints // d
        same = node[schur.row] == node[schur.col]  # of couplings between joints none is kept
        row, col = joints[schur.row[same]], joints[schur.col[same]]
        halo = local.halo  # of unknowns, not nodes; on one rank there are no joints
        blocks = np.zeros((len(line) if halo.comm.size > 1 else 0, d))
        blocks[row, col % d] = schur.data[same]
        halo.reverse(blocks)
        self.own, schur = own, blocks[own].reshape(-1, d, d)
        try:
            self.schur = np.linalg.inv(0.5 * (schur + np.swapaxes(schur, 1, 2)))
        except np.linalg.LinAlgError:  # on this rank: YarnSmoother tells the others
            self.schur = np.full_like(schur, np.nan)

    def solve(self, b: np.ndarray, x: np.ndarray, weight: float = 1.0, first: bool = False) -> None:
        """Put the family's unknowns into equilibrium with the others'. Collective.

        b (n_owned,) is the load; x (n_local,) the displacement, all zero if ``first``. It is moved
        by ``weight`` of the way.
        """
        halo, y = self.local.halo, self.y
        alone = halo.comm.size == 1
        arrays = self.rows, *self.outer, *self.factor, b, x, y, weight
        _solve(self.groups, self.local.block == 3, first, True, alone, *arrays)
        if not alone:
            right = np.zeros(len(x))
            right[self.own] = b[self.own]
            right[self.joints] -= self.joints_outer @ x + self.eliminated @ y
            halo.reverse(right)
            known = right[self.own].reshape(-1, self.local.block)
            right[self.own] = np.einsum("nij,nj->ni", self.schur, known).ravel()
            halo.forward(right)
            y -= self.eliminated.T @ right[self.joints]
            x[self.own] += weight * (right[self.own] - x[self.own])
            _solve(self.groups, False, False, False, True, *arrays)
        halo.forward(x)


def _joints(local: _Local, line: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unknowns at which yarns are cut between ranks: own ones, and ghosts of lower ranks."""
    halo, d = local.halo, local.block
    n, begin = halo.num_owned, local.pointer[halo.num_owned]
    ghost = np.repeat(np.arange(n, len(line)), np.diff(local.pointer[n:]))
    own = local.column[begin:]
    along = (line[ghost] >= 0) & (line[ghost] == line[own]) & (local.value[begin:] != 0)
    ghost, own = ghost[along], own[along]
    higher = halo.ghost_owner[ghost - n] > halo.comm.rank
    cut = own[higher & local.joint[own]], ghost[~higher & local.joint[ghost]]
    return _unknowns(np.unique(cut[0] // d), d), _unknowns(np.unique(cut[1] // d), d)


def _rows_from(n: int, pointer, column, value, width: int) -> csr_array:
    """Rows from the n-th on of some compressed ones."""
    part = slice(pointer[n], pointer[-1])
    return csr_array(
        (value[part], column[part], pointer[n:] - pointer[n]), (len(pointer) - n - 1, width)
    )


def _unknowns(nodes: np.ndarray, block: int) -> np.ndarray:
    """All unknowns of some nodes."""
    return (nodes[:, None] * block + np.arange(block)).ravel()


class YarnSmoother:
    """Gauss-Seidel between the two families of yarns, as a PETSc preconditioner. Collective.

    The matrix (AIJ) is symmetric, positive definite; its block size is the number of unknowns per
    node, and nodes are not split between yarns. ``lines`` are of the unknowns that this rank owns.
    Raises SolverError on every rank if yarns cannot be joined where ranks meet.
    """

    def __init__(self, matrix: PETSc.Mat, lines: OnYarns):
        comm = matrix.comm.tompi4py()
        with local_rows(matrix) as rows:
            block = max(matrix.getBlockSize(), 1)
            # Whole nodes: of some of a node's unknowns this rank's rows may hold no entry.
            ghost = _unknowns(np.unique(rows.ghost // block), block)
            n = len(rows.pointer) - 1
            halo = Halo.of_numbers(comm, n, ghost)
            size = n + len(ghost)
            line, place = np.full((size, 2), -1, np.int32), np.zeros((size, 2))
            joint = np.ones(size, bool)
            line[:n], place[:n] = lines.line, lines.place
            if lines.joint is not None:
                joint[:n] = lines.joint
            for values in (line, place, joint):
                halo.forward(values)
            arrays = rows.pointer, rows.column, rows.value
            if len(ghost):
                column = np.searchsorted(ghost, rows.ghost)[rows.ghost_column]
                arrays = _merge(*arrays, rows.ghost_pointer, column, rows.ghost_value, len(ghost))
            local = _Local(*arrays, halo, block, joint)
            self.families = [
                _Family(local, np.ascontiguousarray(line[:, f]), np.ascontiguousarray(place[:, f]))
                for f in (0, 1)
            ]
            local.pointer = local.column = local.value = np.zeros(0)  # borrowed: forget them
        self.halo, self._x = halo, np.zeros(size)
        if not comm.allreduce(all(np.isfinite(f.schur).all() for f in self.families), MPI.LAND):
            raise SolverError(
                "the yarn multigrid finds yarns without stiffness where ranks meet: a part of the "
                "preform may be free to move; try yarn bending or another pc_type",
                "SETUP",
            )

    def apply(
        self, b: np.ndarray, order: Sequence[tuple[int, float]], x: np.ndarray | None = None
    ) -> np.ndarray:
        """Solve families in some order, each moved so far, from x (n_owned,) or zero. Collective.

        Returns x (n_owned,), which the next call overwrites.
        """
        local = self._x
        if x is None:
            local[:] = 0.0
        else:
            local[: len(b)] = x
            self.halo.forward(local)
        for k, (family, weight) in enumerate(order):
            self.families[family].solve(b, local, weight, first=x is None and k == 0)
        return local[: len(b)]

    def attach(self, pc: PETSc.PC, level: int, sweeps: int) -> None:
        """Make this the smoother of a level of a PCMG."""
        order = steps(sweeps)
        for ksp, families in (
            (pc.getMGSmootherDown(level), order),
            (pc.getMGSmootherUp(level), order[::-1]),
        ):
            # Out of reach of the options for the other levels, which PETSc applies later on.
            ksp.setOptionsPrefix(f"{pc.getOptionsPrefix() or ''}mg_yarn_")
            ksp.setType(PETSc.KSP.Type.PYTHON)
            ksp.setPythonContext(_Sweeps(self, families))
            ksp.setNormType(PETSc.KSP.NormType.PRECONDITIONED)  # what it is, if it were taken
            ksp.getPC().setType(PETSc.PC.Type.NONE)


@dataclass
class _Sweeps:
    """What PETSc calls. Sweeps start from what is there: no residual is needed."""

    smoother: YarnSmoother
    order: Sequence[tuple[int, float]]

    @callback
    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        start = x.getArray(readonly=True) if ksp.getInitialGuessNonzero() else None
        x.setArray(self.smoother.apply(b.getArray(readonly=True), self.order, start))
        ksp.setConvergedReason(PETSc.KSP.ConvergedReason.CONVERGED_ITS)
