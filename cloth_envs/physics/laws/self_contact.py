"""Contact of the cloth with itself in plain NumPy: every pair, one after the other; what the kernel is tested against.

A pair is a vertex and a triangle, or two edges, without a common vertex: four vertices ``(4,)``, whose shares in the
vector from the second's nearest point to the first's add up to 0.
"""

from collections.abc import Callable

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.scene import Scene

Nearest = Callable[[np.ndarray], np.ndarray]  # shares of (N, 4, 3)

RELAX = 0.001  # s, in which layers that are too near go apart,
CREEP = 1.0  # m/s, at most, over how many pairs a vertex is in
PASSES = 4  # over all pairs, while one is nearer than half a layer


def vertices_and_triangles(grid: Grid) -> np.ndarray:
    """``(N, 4)``: a vertex and the corners of a triangle."""
    vertex, face = (i.ravel() for i in np.indices((grid.vertices, len(grid.triangles))))
    return _apart(np.column_stack([vertex, grid.triangles[face]]), 1)


def pairs_of_edges(grid: Grid) -> np.ndarray:
    """``(N, 4)``: the ends of two edges of triangles, each two once."""
    ends = np.sort(np.concatenate([grid.triangles[:, [0, 1]], grid.triangles[:, [1, 2]], grid.triangles[:, [2, 0]]]))
    ends = np.unique(ends, axis=0)
    first, second = np.triu_indices(len(ends), 1)
    return _apart(np.column_stack([ends[first], ends[second]]), 2)


def _apart(pairs: np.ndarray, first: int) -> np.ndarray:
    """Those whose ``first`` vertices are none of the others."""
    return pairs[(pairs[:, :first, None] != pairs[:, None, first:]).all((1, 2))]


def nearest_in_triangle(x: np.ndarray) -> np.ndarray:
    """Shares ``(N, 4)`` of vertices and triangles ``x`` ``(N, 4, 3)``: 1, and those of the triangle's nearest point.

    The nearest of the point of its plane, if that is inside, and of one on each of its edges.
    """
    p, a, b, c = x.transpose(1, 0, 2)
    e, f, q = b - a, c - a, p - a
    n = np.cross(e, f)
    size = np.where(_dot(n, n) > 0, _dot(n, n), 1)
    u, v = _dot(np.cross(q, f), n) / size, _dot(np.cross(e, q), n) / size
    inside = (_dot(n, n) > 0) & (u >= 0) & (v >= 0) & (u + v <= 1)
    s, t, w = _on_segment(p, a, b), _on_segment(p, a, c), _on_segment(p, b, c)
    none = 0 * s
    corners = [(1 - s, s, none), (1 - t, none, t), (none, 1 - w, w), (1 - u - v, u, v)]
    shares = np.array([np.column_stack([1 + none, -i, -j, -k]) for i, j, k in corners])
    shares[3][~inside] = shares[0][~inside]
    return _least(shares, x)


def nearest_on_edges(x: np.ndarray) -> np.ndarray:
    """Shares ``(N, 4)`` of the ends of two edges ``x`` ``(N, 4, 3)``.

    The nearest of the points of their lines, if both are inside, and of each end and the other edge.
    """
    a, b, c, d = x.transpose(1, 0, 2)
    e, f, r = b - a, d - c, a - c
    ee, ef, ff, er, fr = _dot(e, e), _dot(e, f), _dot(f, f), _dot(e, r), _dot(f, r)
    area = ee * ff - ef * ef
    lines = np.where(area > 0, area, 1)
    s, t = (ef * fr - er * ff) / lines, (ee * fr - ef * er) / lines
    inside = (area > 0) & (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    none, one = 0 * s, 1 + 0 * s
    places = [(none, _on_segment(a, c, d)), (one, _on_segment(b, c, d))]
    places += [(_on_segment(c, a, b), none), (_on_segment(d, a, b), one)]
    places.append((np.where(inside, s, places[0][0]), np.where(inside, t, places[0][1])))
    return _least(np.array([np.column_stack([1 - s, s, t - 1, -t]) for s, t in places]), x)


def _on_segment(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Where between ``a`` and ``b``, in [0, 1], the point nearest to ``p`` is."""
    size = _dot(b - a, b - a)
    return np.clip(_dot(p - a, b - a) / np.where(size > 0, size, 1), 0, 1)


def _least(shares: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Of ``shares`` ``(K, N, 4)`` those of the shortest vector."""
    d = np.einsum("knq,nqi->kni", shares, x)
    return shares[_dot(d, d).argmin(0), np.arange(len(x))]


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * b).sum(-1)


def mobility(scene: Scene) -> np.ndarray:
    """1 / mass of vertices over that of an inner one, ``(H * W,)``; 0 of firmly held ones."""
    area = scene.grid.areas.ravel()
    loose = area.max() / area
    loose[list(scene.pins)] = 0
    return loose


class SelfContact:
    """Keeps one cloth apart, step after step of ``h`` [s]; what lies on which side is found in the first.

    Args:
        scene: with ``self_contact``.
        h: of a step, long enough that nothing has to be foreseen for several: see ``near.hpp``, ``Looking``.
    """

    def __init__(self, scene: Scene, h: float) -> None:
        self.scene, self.h, self.loose = scene, h, mobility(scene)
        self.kinds = [
            (vertices_and_triangles(scene.grid), nearest_in_triangle),
            (pairs_of_edges(scene.grid), nearest_on_edges),
        ]
        self.sides = [np.zeros((len(pairs), 3)) for pairs, _ in self.kinds]

    def step(self, x: np.ndarray, v: np.ndarray) -> list[np.ndarray]:
        """Change positions and velocities ``(H * W, 3)`` at a step's end; the pairs that were due."""
        found = []
        for kind, (pairs, nearest) in enumerate(self.kinds):
            share = nearest(x[pairs])
            d, u = (np.einsum("nq,nqi->ni", share, field[pairs]) for field in (x, v))
            far = np.linalg.norm(d, axis=1)
            way = np.where((_dot(d, self.sides[kind]) < 0) & (far < 2 * self.scene.layer), -1, 1)
            self.sides[kind] = d * (way / np.where(far > 0, far, 1))[:, None]
            closing = np.maximum(-_dot(u, self.sides[kind]), 0)
            due = np.flatnonzero((way < 0) | (far - self.scene.layer < self.h * closing))
            crowd = np.bincount(pairs[due].ravel(), minlength=len(x))
            deep = True
            for number in range(PASSES):
                if deep:
                    slow = [self.h / crowd[pairs[i]].max() if number == 0 else 0.0 for i in due]
                    near = [
                        self._resolve(x, v, pairs[i], nearest, self.sides[kind][i], t)
                        for i, t in zip(due, slow, strict=True)
                    ]
                    deep = any(near)
            found.append(pairs[due])
        return found

    def _resolve(
        self, x: np.ndarray, v: np.ndarray, pair: np.ndarray, nearest: Nearest, side: np.ndarray, time: float
    ) -> bool:
        """Keep one pair apart; whether it was nearer than half a layer.

        An impulse ``j`` along the unit vector ``n`` between the nearest points changes the velocity of vertex ``q`` by
        ``w_q s_q j``, with its share ``s_q`` and mobility ``w_q``, so that of the points by ``sum w_q s_q^2 j``: until
        they come no nearer than a layer within the step. Friction takes up to mu times that from the sliding velocity.
        Vertices lie where these velocities would have taken them. What is missing then is made up for by moving them
        along ``n`` in the same shares, for a ``time`` [s] slowly, or at once if the pair had gone through.
        """
        layer, mu = self.scene.layer, self.scene.self_contact.friction if self.scene.self_contact else 0.0
        share = nearest(x[pair][None])[0]
        d, u, give = share @ x[pair], share @ v[pair], self.loose[pair] @ share**2
        far = np.linalg.norm(d)
        apart = -far if d @ side < 0 else far
        n, gap = d / apart if far > 1e-6 else side, apart - layer
        speed = u @ n
        stop = max((-gap / self.h if gap > 0 else 0) - speed, 0)
        if give == 0 or (stop == 0 and gap >= 0):
            return False
        slow = time * min(max(-gap, 0) / RELAX, CREEP)
        slide = u - speed * n
        sliding = np.linalg.norm(slide)
        hold = min(mu * stop / sliding, 1) if sliding > 0 else 0
        part = (self.loose[pair] * share / give)[:, None]
        kick = part * (stop * n - hold * slide)
        x[pair] += self.h * kick + part * (min(far, layer) if apart < 0 else slow) * n
        v[pair] += kick
        return bool(gap < -layer / 2)
