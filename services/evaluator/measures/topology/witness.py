"""The relaxed witness complex up to triangles, straight from the distances of witnesses to landmarks.

Source: de Silva and Carlsson, Topological estimation using witness complexes, 2004. The rule is GUDHI's
``WitnessComplex``: a witness lets a simplex appear once the relaxation makes up for how much farther its
farthest vertex is than the nearest landmark that it leaves out. A simplex appears at its earliest witness,
never before its faces. GUDHI takes the distances as lists of Python pairs, which cost far more than the
complex; here they stay an array, and GUDHI gets the simplices.
"""

from dataclasses import dataclass

import gudhi
import numpy as np
from numpy.typing import NDArray

from cspace.kernel_cache import njit


@dataclass(frozen=True, slots=True)
class WitnessComplex:
    """Edges and triangles with the relaxation at which they appear; every vertex appears at 0.

    Args:
        landmarks: number of vertices.
        edges: (2, E) vertices.
        edge_values: (E,) relaxations.
        triangles: (3, T) vertices.
        triangle_values: (T,) relaxations.
    """

    landmarks: int
    edges: NDArray[np.int32]
    edge_values: NDArray[np.float64]
    triangles: NDArray[np.int32]
    triangle_values: NDArray[np.float64]

    def loop_intervals(self) -> NDArray[np.float64]:
        """(M, 2) birth and death of the loops (H1 over the field of two elements)."""
        tree = gudhi.SimplexTree()
        tree.insert_batch(np.arange(self.landmarks, dtype=np.int32)[None], np.zeros(self.landmarks))
        tree.insert_batch(self.edges, self.edge_values)
        tree.insert_batch(self.triangles, self.triangle_values)
        tree.compute_persistence(homology_coeff_field=2)
        return np.asarray(tree.persistence_intervals_in_dimension(1), dtype=np.float64).reshape(-1, 2)


def witness_complex(distances: NDArray[np.float64], alpha_max: float) -> WitnessComplex:
    """The complex of (N, L) distances between N witnesses and L landmarks, which are witnesses themselves.

    Args:
        distances: L is three or more.
        alpha_max: largest relaxation, in the units of the distances.
    """
    landmarks = distances.shape[1]
    edges, triangles = _earliest(distances, alpha_max)
    parts = _present(landmarks, edges, triangles)
    return WitnessComplex(landmarks, *parts)


@njit(cache=True, nogil=True)
def _edge(low, high):  # type: ignore[no-untyped-def]
    """Place of an edge in the list of all pairs, by the combinatorial number system."""
    return high * (high - 1) // 2 + low


@njit(cache=True, nogil=True)
def _triangle(first, second, third):  # type: ignore[no-untyped-def]
    """Place of a triangle in the list of all triples, whatever the order of its vertices."""
    low, high = min(first, second, third), max(first, second, third)
    middle = first + second + third - low - high
    return high * (high - 1) * (high - 2) // 6 + middle * (middle - 1) // 2 + low


@njit(cache=True, nogil=True)
def _nearest(row, alpha_max, indices, lengths):  # type: ignore[no-untyped-def]
    """The landmarks that a witness can use, nearest first; how many.

    No simplex has more than three vertices, so none reaches beyond the relaxation of the third nearest.
    """
    first = second = third = np.inf
    for landmark in range(row.shape[0]):
        length = row[landmark]
        if length < third:
            if length < second:
                third = second
                if length < first:
                    first, second = length, first
                else:
                    second = length
            else:
                third = length
    count = 0
    for landmark in range(row.shape[0]):
        length = row[landmark]
        if length - alpha_max <= third:
            place = count
            while place > 0 and lengths[place - 1] > length:
                lengths[place], indices[place] = lengths[place - 1], indices[place - 1]
                place -= 1
            lengths[place], indices[place] = length, landmark
            count += 1
    return count


@njit(cache=True, nogil=True)
def _earliest(distances, alpha_max):  # type: ignore[no-untyped-def]
    """Earliest relaxation of every pair and triple, its faces not asked; infinite where there is none."""
    landmarks = distances.shape[1]
    edges = np.full(landmarks * (landmarks - 1) // 2, np.inf)
    triangles = np.full(landmarks * (landmarks - 1) * (landmarks - 2) // 6, np.inf)
    near, lengths = np.empty(landmarks, dtype=np.int64), np.empty(landmarks)
    for witness in range(distances.shape[0]):
        count = _nearest(distances[witness], alpha_max, near, lengths)
        for c in range(1, count):
            for b in range(c):
                # The nearest landmark that the pair of ranks b < c leaves out, if it is nearer than c.
                omitted = lengths[0] if b > 0 else lengths[1]
                if lengths[c] - alpha_max <= omitted:
                    place = _edge(min(near[b], near[c]), max(near[b], near[c]))
                    edges[place] = min(edges[place], lengths[c] - omitted)
                for a in range(b):
                    omitted = lengths[0] if a > 0 else lengths[1] if b > 1 else lengths[2]
                    if lengths[c] - alpha_max > omitted:
                        break
                    place = _triangle(near[a], near[b], near[c])
                    triangles[place] = min(triangles[place], lengths[c] - omitted)
    return edges, triangles


@njit(cache=True, nogil=True)
def _present(landmarks, edge_values, triangle_values):  # type: ignore[no-untyped-def]
    """The simplices that appear, none before its faces."""
    edges = np.empty((2, np.isfinite(edge_values).sum()), dtype=np.int32)
    triangles = np.empty((3, np.isfinite(triangle_values).sum()), dtype=np.int32)
    appear_edges, appear_triangles = np.empty(edges.shape[1]), np.empty(triangles.shape[1])
    pairs, triples, place = 0, 0, 0
    for high in range(landmarks):
        for middle in range(high):
            side = edge_values[_edge(middle, high)]
            if np.isfinite(side):
                edges[:, pairs] = middle, high
                appear_edges[pairs] = side
                pairs += 1
            for low in range(middle):
                faces = max(side, edge_values[_edge(low, high)], edge_values[_edge(low, middle)])
                value = max(faces, triangle_values[place])
                place += 1
                if np.isfinite(value):
                    triangles[0, triples], triangles[1, triples], triangles[2, triples] = low, middle, high
                    appear_triangles[triples] = value
                    triples += 1
    return edges, appear_edges, triangles[:, :triples], appear_triangles[:triples]
