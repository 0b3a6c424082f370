"""Groups of strongly joined nodes of a weighted graph, and the smaller graph they make.

A graph is kept as rows: ``starts`` (n + 1,) int64, ``neighbours`` (e,) int32 ascending within a
row and never the row itself, ``conductances`` (e,) float64 > 0, every edge in both rows; and
``excess`` (n,) float64 ≥ 0, what joins a node to given values. The matrix that is meant has
``excess`` plus a row's conductances on the diagonal and minus the conductances beside it. It is
never formed: the diagonal is a sum of positive numbers at every size, so that a group that hangs
by 10⁻⁸ at the rest keeps that number in full, where differences of large ones would lose it.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

LEFT_OUT = -1
_MOST_MEMBERS = 8


@njit(cache=True, nogil=True)
def rows_of_edges(
    edges: NDArray[np.int32], conductances: NDArray[np.float64], nodes: int
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float64]]:
    """Rows of a graph from its undirected edges (m, 2), each given once."""
    m = len(edges)
    starts = np.zeros(nodes + 1, np.int64)
    for e in range(m):
        starts[edges[e, 0] + 1] += 1
        starts[edges[e, 1] + 1] += 1
    for i in range(nodes):
        starts[i + 1] += starts[i]
    # Two passes of a counting sort: columns ascend where rows are filled in their order.
    at = starts[:-1].copy()
    rows = np.empty(2 * m, np.int32)
    values = np.empty(2 * m)
    for e in range(m):
        a, b = edges[e, 0], edges[e, 1]
        rows[at[a]], values[at[a]] = b, conductances[e]
        at[a] += 1
        rows[at[b]], values[at[b]] = a, conductances[e]
        at[b] += 1
    neighbours = np.empty(2 * m, np.int32)
    sorted_values = np.empty(2 * m)
    at[:] = starts[:-1]
    for i in range(nodes):
        for k in range(starts[i], starts[i + 1]):
            j = rows[k]
            neighbours[at[j]], sorted_values[at[j]] = i, values[k]
            at[j] += 1
    return starts, neighbours, sorted_values


@njit(cache=True, nogil=True)
def diagonal_of(
    starts: NDArray[np.int64], conductances: NDArray[np.float64], excess: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n,) what the matrix has on its diagonal."""
    diagonal = np.empty(len(excess))
    for i in range(len(excess)):
        total = excess[i]
        for k in range(starts[i], starts[i + 1]):
            total += conductances[k]
        diagonal[i] = total
    return diagonal


@njit(cache=True, nogil=True)
def _in_series(a: float, b: float) -> float:
    """Conductance of two one after the other."""
    total = a + b
    return a * b / total if total > 0.0 else 0.0


@njit(cache=True, nogil=True)
def pairs(
    starts: NDArray[np.int64],
    neighbours: NDArray[np.int32],
    conductances: NDArray[np.float64],
    excess: NDArray[np.float64],
    diagonal: NDArray[np.float64],
    quality: float,
) -> tuple[NDArray[np.int32], int]:
    """Each node with the neighbour it is best lumped with.

    Nodes that given values hold so firmly that smoothing alone settles them are left out.
    Source: Napov and Notay 2012, algorithm 4.2 and the bound (3.10) for pairs.

    Parameters
    ----------
    quality : no pair may be worse: an upper bound of the two-grid condition number.

    Returns
    -------
    Group (n,) of every node, ``LEFT_OUT`` for none, and the number of groups.
    """
    n = len(excess)
    open_ = np.int32(-2)
    group = np.full(n, open_, np.int32)
    for i in range(n):
        if diagonal[i] * (quality - 2.0) >= quality * (diagonal[i] - excess[i]):
            group[i] = LEFT_OUT
    count = 0
    for i in range(n):
        if group[i] != open_:
            continue
        best, least = -1, quality
        for k in range(starts[i], starts[i + 1]):
            j = neighbours[k]
            if group[j] != open_:
                continue
            held = conductances[k] + _in_series(excess[i], excess[j])
            worth = 2.0 * _in_series(diagonal[i], diagonal[j]) / held
            if worth < least:
                best, least = j, worth
        group[i] = count
        if best >= 0:
            group[best] = count
        count += 1
    return group, count


@njit(cache=True, nogil=True)
def members_of(group: NDArray[np.int32], count: int) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Where each group's members begin (count + 1,), and the members in ascending order."""
    starts = np.zeros(count + 1, np.int64)
    for g in group:
        if g >= 0:
            starts[g + 1] += 1
    for g in range(count):
        starts[g + 1] += starts[g]
    at = starts[:-1].copy()
    members = np.empty(starts[count], np.int32)
    for i in range(len(group)):
        if group[i] >= 0:
            members[at[group[i]]] = i
            at[group[i]] += 1
    return starts, members


@njit(cache=True, nogil=True)
def smaller_graph(
    starts: NDArray[np.int64],
    neighbours: NDArray[np.int32],
    conductances: NDArray[np.float64],
    excess: NDArray[np.float64],
    group: NDArray[np.int32],
    count: int,
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
    """The graph of the groups: Galerkin's operator for corrections constant within each.

    What joins a group to a node that is left out, which gets no correction, is excess.

    Returns
    -------
    starts, neighbours, conductances, excess of the smaller graph.
    """
    first, members = members_of(group, count)
    coarse_starts = np.zeros(count + 1, np.int64)
    coarse_neighbours = np.empty(len(neighbours), np.int32)
    coarse_conductances = np.empty(len(neighbours))
    coarse_excess = np.zeros(count)
    place = np.full(count, -1, np.int64)
    used = 0
    for g in range(count):
        begin = used
        for m in range(first[g], first[g + 1]):
            i = members[m]
            coarse_excess[g] += excess[i]
            for k in range(starts[i], starts[i + 1]):
                other = group[neighbours[k]]
                if other == g:
                    continue
                if other < 0:
                    coarse_excess[g] += conductances[k]
                elif place[other] >= begin:
                    coarse_conductances[place[other]] += conductances[k]
                else:
                    place[other] = used
                    coarse_neighbours[used] = other
                    coarse_conductances[used] = conductances[k]
                    used += 1
        for k in range(begin + 1, used):
            name, value = coarse_neighbours[k], coarse_conductances[k]
            p = k
            while p > begin and coarse_neighbours[p - 1] > name:
                coarse_neighbours[p] = coarse_neighbours[p - 1]
                coarse_conductances[p] = coarse_conductances[p - 1]
                p -= 1
            coarse_neighbours[p], coarse_conductances[p] = name, value
        # A later group's entries lie further on, whatever was left in ``place``.
        coarse_starts[g + 1] = used
    return (
        coarse_starts,
        coarse_neighbours[:used].copy(),
        coarse_conductances[:used].copy(),
        coarse_excess,
    )


@njit(cache=True, nogil=True)
def _holds(
    inside: NDArray[np.float64],
    excess: NDArray[np.float64],
    diagonal: NDArray[np.float64],
    size: int,
    quality: float,
    work: NDArray[np.float64],
) -> bool:
    """Whether quality · A − 2 D (I − 1 1ᵀ D / 1ᵀ D 1) of a group is positive semidefinite."""
    total = 0.0
    for a in range(size):
        total += diagonal[a]
    for a in range(size):
        here = quality * excess[a]
        for b in range(size):
            if b != a:
                here += quality * inside[a, b]
                work[a, b] = -quality * inside[a, b] + 2.0 * diagonal[a] * diagonal[b] / total
        work[a, a] = here - 2.0 * diagonal[a] * (1.0 - diagonal[a] / total)
    for a in range(size):
        pivot = work[a, a]
        if a == size - 1:
            return bool(pivot >= -1e-10 * diagonal[a])
        if pivot <= 0.0:
            return False
        for b in range(a + 1, size):
            share = work[b, a] / pivot
            for c in range(a + 1, size):
                work[b, c] -= share * work[a, c]
    return True


@njit(cache=True, nogil=True)
def merged(
    starts: NDArray[np.int64],
    neighbours: NDArray[np.int32],
    conductances: NDArray[np.float64],
    excess: NDArray[np.float64],
    diagonal: NDArray[np.float64],
    group: NDArray[np.int32],
    count: int,
    group_starts: NDArray[np.int64],
    group_neighbours: NDArray[np.int32],
    group_conductances: NDArray[np.float64],
    quality: float,
) -> tuple[NDArray[np.int32], int]:
    """Groups merged with the one they are joined to most strongly, where the bound allows it.

    The bound is checked on the nodes themselves, so that it holds for the whole step.

    Parameters
    ----------
    starts to diagonal : the graph of the nodes.
    group, count : the groups; none grows beyond eight nodes.
    group_starts to group_conductances : the graph of the groups.
    quality : as for `pairs`.

    Returns
    -------
    Group (n,) of every node and the number of groups.
    """
    first, members = members_of(group, count)
    into = np.full(count, -1, np.int32)
    inside = np.zeros((_MOST_MEMBERS, _MOST_MEMBERS))
    work = np.zeros((_MOST_MEMBERS, _MOST_MEMBERS))
    own_excess, own_diagonal = np.zeros(_MOST_MEMBERS), np.zeros(_MOST_MEMBERS)
    node = np.zeros(_MOST_MEMBERS, np.int32)
    groups = 0
    for p in range(count):
        if into[p] >= 0:
            continue
        into[p] = groups
        tried = np.inf
        last = -1
        while True:
            # The next strongest, the lower one first among equals.
            best, most = -1, 0.0
            for k in range(group_starts[p], group_starts[p + 1]):
                q, g = group_neighbours[k], group_conductances[k]
                below = g < tried or (g == tried and q > last)
                if into[q] < 0 and below and g > most:
                    best, most = q, g
            if best < 0:
                break
            tried, last = most, best
            size = 0
            if first[p + 1] - first[p] + first[best + 1] - first[best] > _MOST_MEMBERS:
                continue
            for h in range(2):
                one = p if h == 0 else best
                for m in range(first[one], first[one + 1]):
                    node[size] = members[m]
                    own_excess[size] = excess[members[m]]
                    own_diagonal[size] = diagonal[members[m]]
                    size += 1
            inside[:] = 0.0
            for a in range(size):
                for k in range(starts[node[a]], starts[node[a] + 1]):
                    for b in range(size):
                        if neighbours[k] == node[b]:
                            inside[a, b] = conductances[k]
            if _holds(inside, own_excess, own_diagonal, size, quality, work):
                into[best] = groups
                break
        groups += 1
    result = np.empty_like(group)
    for i in range(len(group)):
        result[i] = into[group[i]] if group[i] >= 0 else LEFT_OUT
    return result, groups
