// Which vertices and triangles, and which edges, of one cloth may come close while its vertices go straight on: first
// blocks of cells by their boxes, then cells by theirs and by their planes, then distances. All of it errs towards too
// many.
#pragma once
#include <algorithm>
#include <cstdint>
#include <utility>
#include <vector>

#include "../base/dispatch.hpp"
#include "../base/geometry.hpp"

namespace minicloth {

constexpr int kSide = 4, kCells = kSide * kSide;  // cells along a block's side, in a block; the same of blocks in a group
constexpr int kBox = 12;     // lo and hi x, y, z of points now, then of them later
constexpr int kRecord = 32;  // numbers of a cell: x, y, z of its corners now, then later, and 8 that are free
constexpr int kVertexParts = 4, kParts = 13;      // pairs of a vertex and a triangle, and all, of two cells: see parts

// Cell (r, c) is numbered as the vertex at its upper left, and owns that vertex, the edges from it to the right, down
// and along the diagonal, and two triangles; in the last row and column some of these do not exist. Slot i of block or
// group b is number kCells * b + i, in row-major order inside it.
template <class T>
struct Sweep {
  int rows = 0, cols = 0;
  bool periodic = false;
  int block_rows, block_cols, group_rows, group_cols, groups, blocks;
  std::size_t plane;          // numbers in a plane of vertices or cells, some to spare behind
  Plane<T> now, then;         // of vertices, 3 planes each: where they are, where they will be
  Plane<T> normal, even;      // of cells, over their rest area; 1 where neighbours are nearly level with it, else -1
  Plane<T> box, group, cone;  // kBox planes of blocks and of groups; 6 of blocks, the box of their normals
  // Of blocks where `filled` says so: kBox rows of kCells, of their cells; of every cell of these kRecord numbers.
  Plane<T> slots, records;
  Plane<T> room, slack;                // of blocks: how far their vertices may stray; of vertices, the square of that
  std::vector<char> filled, fresh;     // fresh: only what lies in these blocks is searched
  std::vector<std::uint16_t> level;    // of such blocks: bit i if cell i is even
  std::vector<int> at;                 // of every block its first cell, -1 where the sheet has none
  std::vector<int> corner[4];          // vertices of every cell: upper left, upper right, lower left, lower right
  std::vector<std::int16_t> row, col;  // of every cell
  std::vector<std::pair<int, int>> close_blocks, close_cells;
  std::vector<int> of_block;           // of close cells, which of close_blocks they are in

  void shape(int rows, int cols, bool periodic);
  // use(vertex) for all that a block has: its cells' corners.
  template <class Use>
  void each_vertex(int block, const Use& use) const {
    const int first = at[block], r1 = std::min(kSide + 1, rows - row[first]), left = cols - col[first];
    const int c1 = std::min(kSide + 1, left);
    for (int r = 0; r < r1; ++r) {
      for (int c = 0; c < c1; ++c) use(first + r * cols + c);
      if (periodic && left <= kSide) use(first + r * cols - col[first]);
    }
  }
};

// How often close parts are looked at: one that lies `far` apart and closes at a speed u, in
// (far - danger) / ((u + haste) h) steps, from 1 to kMostSteps. kAct says that it has to be kept apart before.
constexpr int kMostSteps = 16, kAct = 128;
template <class T>
struct Looking {
  T reach, danger, haste, h;  // m, m, m/s, s
};

template <class T>
struct NearLanes {
  void (*boxes)(Sweep<T>&, T cell_area);
  void (*fresh_boxes)(Sweep<T>&, T cell_area);  // of fresh blocks alone
  // Marks blocks as fresh of which a vertex, now at x, strayed from the point `part` of its way; how many.
  int (*stray)(Sweep<T>&, const Plane<T>& x, T part);
  // Blocks that come nearer than reach + 2 skin are close; others leave their vertices `room` to stray, up to most.
  void (*blocks)(Sweep<T>&, T reach, T skin, T most);
  void (*cells)(Sweep<T>&, T reach);
  // Of all close cells: wait[i][k], in how many steps to look first at their parts k, 0 where these stay apart by reach
  // and skin while vertices go their ways in `time`. Parts 0, 1: vertex of the first, lower and upper triangle of the
  // second; 2, 3: the other way round; 4 + 3 a + b: edges a and b. The last two numbers: any of vertices, of edges.
  void (*parts)(const Sweep<T>&, const Looking<T>& vertices, const Looking<T>& edges, T skin, T time,
                std::uint8_t (*wait)[kParts + 2]);
  // Of `count` pairs of parts, numbers in `parts`, which are elements of a field: when to look at each again. `side` has
  // of every pair the unit vector from its second to its first part when these were last looked at, 0 before; a pair
  // whose vector turned round since went through each other, and its vector is the old way round.
  void (*look)(const T* x, const T* v, int width, const int (*parts)[4], const int* which, int count, bool edges,
               const Looking<T>&, T (*side)[3], std::uint8_t* wait);
  // Of every lane: the largest square of how far its vertices are from x0 + since * v0, and whether that is more than
  // the square of their `room` for some.
  void (*drift)(const T* x, const T* x0, const T* v0, const T* room, int rows, int cols, std::ptrdiff_t stride,
                const T* since, T* most, T* astray);
};
DECLARE_LANES(NearLanes<float>)
DECLARE_LANES(NearLanes<double>)

}  // namespace minicloth
