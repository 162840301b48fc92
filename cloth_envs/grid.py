"""The cloth as a regular grid: topology, rest lengths and lumped areas."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cloth_envs.arguments import as_items, as_whole, shown


@dataclass(frozen=True)
class Grid:
    """A sheet of ``rows x cols`` vertices, ``height x width`` metres.

    Row ``r``, column ``c`` is vertex ``r * cols + c``. Rows run along ``height``, columns along
    ``width``. With ``periodic`` the last column is joined to the first (a tube), so the sheet has
    ``cols`` cells across instead of ``cols - 1``.

    Raises:
        ValueError: fewer than 3 vertices along a side, or a size that is not positive.
    """

    rows: int
    cols: int
    height: float
    width: float
    periodic: bool = False

    def __post_init__(self) -> None:
        if self.rows < 3 or self.cols < 3:
            raise ValueError(
                f"a grid needs at least 3 x 3 vertices for bending, got {self.rows} x {self.cols}; "
                "ask for a larger resolution=(rows, cols)"
            )
        if self.rows * self.cols > 4_000_000:
            raise ValueError(
                f"{self.rows} x {self.cols} is over 4 million vertices; ask for a smaller resolution=(rows, cols)"
            )
        if not (0 < self.height < np.inf and 0 < self.width < np.inf):
            raise ValueError(f"grid sizes must be positive metres, got {self.height} x {self.width}")

    def __str__(self) -> str:
        return f"{self.rows}x{self.cols}"

    @property
    def shape(self) -> tuple[int, int]:
        """``(rows, cols)``."""
        return self.rows, self.cols

    @property
    def vertices(self) -> int:
        return self.rows * self.cols

    @property
    def length(self) -> float:
        """The longer side [m]: what errors are told in parts of."""
        return max(self.height, self.width)

    @property
    def row_spacing(self) -> float:
        """Rest length [m] of the edges between rows."""
        return self.height / (self.rows - 1)

    @property
    def col_spacing(self) -> float:
        """Rest length [m] of the edges along a row."""
        return self.width / (self.cols if self.periodic else self.cols - 1)

    @property
    def diagonal(self) -> float:
        """Rest length [m] of the shear edges."""
        return float(np.hypot(self.row_spacing, self.col_spacing))

    @property
    def cells(self) -> tuple[int, int]:
        """Cells along rows and columns."""
        return self.rows - 1, self.cols if self.periodic else self.cols - 1

    def index(self, row: int, col: int) -> int:
        """Vertex number of ``(row, col)``; negative numbers count from the end."""
        return (row % self.rows) * self.cols + col % self.cols

    @cached_property
    def border(self) -> np.ndarray:
        """Vertex numbers around the border, from the upper left corner along the first row."""
        index = np.arange(self.vertices).reshape(self.shape)
        return np.concatenate([index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]])

    @cached_property
    def areas(self) -> np.ndarray:
        """Lumped area of every vertex, ``(rows, cols)`` [m^2]: halved on edges, quartered on corners."""
        row = np.ones(self.rows)
        row[[0, -1]] = 0.5
        col = np.ones(self.cols)
        if not self.periodic:
            col[[0, -1]] = 0.5
        return np.outer(row, col) * (self.row_spacing * self.col_spacing)

    @cached_property
    def triangles(self) -> np.ndarray:
        """Two counter-clockwise triangles a cell, ``(2 * cells, 3)`` vertex numbers.

        Seen with columns to the right and rows downwards the diagonal runs from the upper left to
        the lower right corner; the normal points towards the viewer.
        """
        r, c = np.indices(self.cells).reshape(2, -1)
        right = (c + 1) % self.cols
        upper_left, upper_right = r * self.cols + c, r * self.cols + right
        lower_left, lower_right = upper_left + self.cols, upper_right + self.cols
        lower = np.stack([upper_left, lower_left, lower_right], 1)
        upper = np.stack([upper_left, lower_right, upper_right], 1)
        return np.stack([lower, upper], 1).reshape(-1, 3)

    @cached_property
    def facets(self) -> np.ndarray:
        """The triangles of both diagonals, ``(4 * cells, 3)``: those of ``triangles`` and as many cut the other way.

        Each stands for half its area; pressure on them is even-handed, so a mirrored cloth moves mirrored.
        """
        lower, upper = self.triangles[0::2], self.triangles[1::2]
        upper_left, lower_left, lower_right = lower.T
        upper_right = upper[:, 2]
        others = [(upper_left, lower_left, upper_right), (lower_left, lower_right, upper_right)]
        return np.concatenate([self.triangles, *(np.stack(corners, 1) for corners in others)])

    def keypoints(self, rows: int, cols: int) -> np.ndarray:
        """Vertex numbers of an even ``rows x cols`` lattice that includes the border, or goes round a tube; flat."""
        r = np.linspace(0, self.rows - 1, rows).round().astype(int)
        c = np.linspace(0, self.cells[1], cols, endpoint=not self.periodic).round().astype(int)
        return (r[:, None] * self.cols + c).ravel()


def coarser(resolution: tuple[int, int], factor: float) -> tuple[int, int]:
    """A grid of the same size with about ``factor`` times the spacing (1/2: half of it), exactly where it divides."""
    rows, cols = (max(3, round((n - 1) / factor) + 1) for n in resolution)
    return rows, cols


def check_resolution(resolution: Sequence[int] | None, default: tuple[int, int]) -> tuple[int, int]:
    """``(rows, cols)``, ``default`` for None. Raises ValueError: anything but two whole numbers."""
    if resolution is None:
        return default
    items = as_items(resolution) or []
    rows, cols = map(as_whole, items) if len(items) == 2 else (None, None)
    if rows is None or cols is None:
        raise ValueError(f"resolution must be two whole numbers (rows, cols) such as (33, 49), got {shown(resolution)}")
    return rows, cols
