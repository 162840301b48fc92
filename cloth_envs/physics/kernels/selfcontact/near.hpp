// Which vertices and triangles, and which edges, of one cloth may come close while its vertices go straight on: first
// blocks of cells by their boxes, then cells by theirs, then distances. Everything errs towards too many, so that what
// touches in the end depends neither on blocks nor on how wide vectors are.
#pragma once
#include <cstdint>
#include <utility>
#include <vector>

#include "../base/dispatch.hpp"
#include "../base/geometry.hpp"

namespace minicloth {

constexpr int kSide = 4, kCells = kSide * kSide;  // cells along a block's side, in a block; the same of blocks in a group

constexpr int kRecord = 16;

// A box of points now and of the same points later: lo x, y, z, hi x, y, z of each.
constexpr int kBox = 12;

// Cell (r, c) is numbered as the vertex at its upper left, and owns that vertex, the edges from it to the right, down
// and along the diagonal, and two triangles; in the last row and column some of these do not exist. Slot i of block or
// group b is number kCells * b + i in row-major order inside it.
template <class T>
struct Sweep {
  int rows = 0, cols = 0;
  bool periodic = false;
  int block_rows, block_cols, group_rows, group_cols, groups, blocks;
  std::size_t plane;          // numbers in a plane of vertices or cells, some to spare behind
  Plane<T> now, then;         // vertices, 3 planes each
  Plane<T> normal, smooth;    // of cells over their rest area, 3 planes; least cosine between it and a neighbour's
  Plane<T> slots;             // kBox rows of kCells, cells' boxes, for every block; where wanted, see filled
  Plane<T> records;           // kRecord numbers of every cell of such blocks: x, y, z of its corners, the middle of the
                              // box of their ways and half its diagonal
  Plane<T> block, cone;       // kBox planes of blocks; 6 of the box of a block's normals
  Plane<T> group;             // kBox numbers of every group
  std::vector<int> at;        // of every block its first cell, -1 where the sheet has none
  std::vector<int> corner[4]; // vertices of every cell: upper left, upper right, lower left, lower right
  std::vector<std::int16_t> row, col;  // of every cell
  std::vector<char> filled;
  std::vector<std::uint16_t> even;  // of a filled block: bit i if its cell i does not meet cells beside it
  std::vector<std::pair<int, int>> close_blocks, close_cells;

  void shape(int rows, int cols, bool periodic);
};

constexpr int kMostSteps = 16, kAct = 128, kParts = 16;  // of which 13 are used

template <class T>
struct Looking {
  T reach, danger, haste, h;  // m, m, m/s, s
};

template <class T>
struct NearLanes {
  void (*boxes)(Sweep<T>&, T cell_area);
  void (*blocks)(Sweep<T>&, T reach);
  void (*cells)(Sweep<T>&, T reach);
  // Of `count` pairs of cells: in how many steps to look first at their parts k, wait[i][k], 0 if they stay apart. Parts
  // 0, 1: vertex of the first, lower and upper triangle of the second; 2, 3: the other way round; 4 + 3 a + b: edges.
  void (*parts)(const Sweep<T>&, const std::pair<int, int>* pairs, int count, const Looking<T>& vertices,
                const Looking<T>& edges, T skin, T time, std::uint8_t (*wait)[kParts]);
  // Of `count` pairs of parts, numbers in `parts`: in how many steps to look at each again (see look in core.hpp), and
  // with kAct added if it has to be resolved now.
  void (*look)(const T* x, const T* v, int width, const int (*parts)[4], const int* which, int count, bool edges,
               const Looking<T>&, std::uint8_t* wait);
  // The largest square of how far the vertices of every lane are from x0 + since * v0.
  void (*drift)(const T* x, const T* x0, const T* v0, int rows, int cols, std::ptrdiff_t stride, const T* since, T* most);
};
DECLARE_LANES(NearLanes<float>)
DECLARE_LANES(NearLanes<double>)

}  // namespace minicloth
