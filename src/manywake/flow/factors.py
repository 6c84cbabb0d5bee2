"""Sparse matrices as the kernels read them: rows, and triangular factors cut into panels."""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

PANEL = 4
"""Most columns of a panel."""


class Rows(NamedTuple):
    """A sparse matrix by rows. value: (nnz,), or (nnz, 2) for two numbers at every place."""

    start: np.ndarray
    column: np.ndarray
    value: np.ndarray


class Panels(NamedTuple):
    """L D U with unit triangles L and U, in panels of neighbouring columns that share the rows below them.

    Panel p has the columns first[p] ... first[p + 1] and the rows row[row_start[p]] ...; its entries begin at
    lower_start[p], row by row, all columns of a row together: of L in `lower`, of U in `upper` (transposed, and empty
    for a symmetric matrix: it is `lower`), with turned signs, and zeros where that saves a panel. lower_corner,
    upper_corner: (panels, 6), the triangle on the diagonal, of L by rows, of U by columns, with turned signs.
    """

    first: np.ndarray
    row_start: np.ndarray
    row: np.ndarray
    lower_start: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    lower_corner: np.ndarray
    upper_corner: np.ndarray
    inverse_diagonal: np.ndarray


def rows(matrix: sp.spmatrix) -> Rows:
    """Return a sparse matrix by sorted rows, without zeros."""
    matrix = sp.csr_matrix(matrix)
    matrix.eliminate_zeros()
    matrix.sort_indices()
    return Rows(matrix.indptr.astype(np.uint32), matrix.indices.astype(np.uint32), matrix.data)


def pair(x: sp.spmatrix, y: sp.spmatrix) -> Rows:
    """Merge two matrices over the union of their entries."""
    x, y = sp.csr_matrix(x), sp.csr_matrix(y)
    union = sp.csr_matrix(abs(x).sign() + abs(y).sign())
    union.sort_indices()
    row = np.repeat(np.arange(union.shape[0]), np.diff(union.indptr))
    value = np.stack([_entries(part, row, union.indices) for part in (x, y)], axis=1)
    return Rows(union.indptr.astype(np.uint32), union.indices.astype(np.uint32), np.ascontiguousarray(value))


def _entries(matrix: sp.csr_matrix, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    return np.asarray(matrix[row, column]).ravel() if len(row) else np.empty(0)  # SciPy returns a matrix for none


def factor(matrix: sp.spmatrix, last: int = 0) -> tuple[Panels, np.ndarray]:
    """Factor a matrix of symmetric structure as L D U after a fill-reducing permutation, returned with it.

    SuperLU in symmetric mode with a minimum-degree ordering, no pivoting: the symmetric part is positive definite.
    last: so many rows at the end stay there in their order, and begin a panel.
    """
    if last:
        order = _with_last(matrix, last)
        lu = _eliminate(matrix[order][:, order], "NATURAL")
    else:
        lu = _eliminate(matrix, "MMD_AT_PLUS_A")
        order = np.argsort(lu.perm_c)
    diagonal = lu.U.diagonal()
    lower = sp.csc_matrix(sp.tril(lu.L, -1))
    symmetric = abs(matrix - matrix.T).max() <= 1e-14 * abs(matrix).max()
    upper = lower if symmetric else sp.csc_matrix((sp.diags(1.0 / diagonal) @ sp.triu(lu.U, 1)).T)
    return panels(lower, upper, diagonal, last), order


def _eliminate(matrix: sp.spmatrix, order: str) -> Any:
    """Factor a matrix in an order that SuperLU finds by this name; RuntimeError where it has to pivot."""
    how: Any = {"permc_spec": order, "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    lu = splu(sp.csc_matrix(matrix), **how)
    if not np.array_equal(lu.perm_r, lu.perm_c):
        raise RuntimeError("factor: SuperLU pivoted, so the matrix is not positive definite; check mesh and viscosity")
    return lu


def _with_last(matrix: sp.spmatrix, last: int) -> np.ndarray:
    """Return a minimum-degree order of all rows but the last ones, then these.

    The last rows count as neighbours of one another, as they are once all others are eliminated: a tenth fewer entries
    than where they do not count.
    """
    n = matrix.shape[0]
    pattern = sp.csr_matrix(abs(matrix).sign() + sp.block_diag([sp.csr_matrix((n - last,) * 2), np.ones((last, last))]))
    order = np.argsort(_eliminate(pattern + 2 * n * sp.identity(n), "MMD_AT_PLUS_A").perm_c)
    return np.concatenate([order[order < n - last], np.arange(n - last, n)])


def panels(lower: sp.csc_matrix, upper: sp.csc_matrix, diagonal: np.ndarray, last: int = 0) -> Panels:
    """Cut strict triangles into panels; `upper` is U transposed, the very `lower` for a symmetric matrix.

    last: so many columns at the end share no panel with others.
    """
    pattern = sp.csc_matrix(abs(lower).sign() + abs(upper).sign())
    pattern.eliminate_zeros()
    pattern.sort_indices()
    first, shared = _cut(np.split(pattern.indices, pattern.indptr[1:-1]), last)
    widths, heights = np.diff(first), np.array([len(part) for part in shared])
    row_start, lower_start = (np.concatenate([[0], np.cumsum(size)]) for size in (heights, heights * widths))
    # place of every entry: (row, column) of the panels' blocks, and of their corners
    block_row = np.concatenate([np.repeat(rows, width) for rows, width in zip(shared, widths, strict=True)])
    columns = zip(pairwise(first), heights, strict=True)
    block_column = np.concatenate([np.tile(np.arange(*ends), height) for ends, height in columns])
    i, j = np.tril_indices(PANEL, -1)
    inside = i[None] < widths[:, None]
    corner_row, corner_column = first[:-1, None] + i, first[:-1, None] + j

    def take(matrix):
        corner = np.zeros(inside.shape)
        corner[inside] = _entries(matrix, corner_row[inside], corner_column[inside])
        return -_entries(matrix, block_row, block_column), -corner

    (lower_block, lower_corner), (upper_block, upper_corner) = (take(sp.csr_matrix(part)) for part in (lower, upper))
    if upper is lower:
        upper_block = np.empty(0)
    first, row_start, lower_start = (places.astype(np.uint32) for places in (first, row_start, lower_start))
    row, corners = np.concatenate(shared).astype(np.uint32), (lower_corner, upper_corner)
    return Panels(first, row_start, row, lower_start, lower_block, upper_block, *corners, 1.0 / diagonal)


def _cut(below: list[np.ndarray], last: int = 0) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return the first column of each panel and the end, and the rows below each: the cheapest cut of all.

    below: the rows of each column's entries. last: so many columns at the end begin a panel. The cost of a panel of w
    columns and r rows, in cycles of a vector core: r (1.4 + 0.65 w) for loads, stores and products, and 10 + 4 w to
    begin with.
    """
    n, known = len(below), [frozenset(part.tolist()) for part in below]
    best, choice = [0.0] + [np.inf] * n, [0] * (n + 1)
    for end in range(1, n + 1):
        shared: frozenset[int] = frozenset()
        for width in range(1, min(PANEL, end if end <= n - last else end - (n - last)) + 1):
            shared = known[end - width] | shared
            rows = len(shared) - sum(column in shared for column in range(end - width + 1, end))
            cost = best[end - width] + rows * (1.4 + 0.65 * width) + 10 + 4 * width
            if cost < best[end]:
                best[end], choice[end] = cost, width
    first = [n]
    while first[-1] > 0:
        first.append(first[-1] - choice[first[-1]])
    first.reverse()
    shared_rows = []
    for begin, end in pairwise(first):
        union = np.unique(np.concatenate(below[begin:end]))
        shared_rows.append(union[union >= end])
    return np.array(first), shared_rows
