"""A mesh moved from a level of density, which lies in the haze before a surface, to the surface itself."""

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.sparse import coo_matrix

from mulan.export.density_mesh import TriangleMesh

_ROUNDS = 4  # of averaging over neighbours: as far as the triangles' own roughness reaches


def settled(mesh: TriangleMesh, gap_m: Float[NDArray, "v"], farthest_m: float) -> TriangleMesh:
    """The mesh with every vertex moved along its normal by its gap, averaged over its neighbours.

    Args:
        mesh: Triangles.
        gap_m: How far outwards the surface lies from each vertex, NaN where unknown; those follow their
            neighbours.
        farthest_m: Gaps beyond are not believed.
    """
    known = np.isfinite(gap_m) & (np.abs(gap_m) <= farthest_m)
    if not known.any():
        return mesh
    size = len(mesh.position_m)
    a, b = mesh.faces.ravel(), np.roll(mesh.faces, 1, axis=1).ravel()
    links = coo_matrix((np.ones(2 * len(a)), (np.r_[a, b], np.r_[b, a])), shape=(size, size)).tocsr()
    total, weight = np.where(known, gap_m, 0.0), known.astype(float)
    degree = np.maximum(np.asarray(links.sum(1)).ravel(), 1.0)
    for _ in range(_ROUNDS):
        # each with its neighbours in equal parts; what is unknown has no weight
        total = (total + links @ total / degree) / 2
        weight = (weight + links @ weight / degree) / 2
    moved_m = total / np.maximum(weight, 1e-9)
    return TriangleMesh(mesh.position_m + moved_m[:, None] * mesh.normals(), mesh.faces)
