// Which vertices and triangles, and which edges, of one cloth may come close while its vertices go straight on: first
// blocks of cells by their boxes, then cells by theirs and by their planes, then distances. All of it errs towards too
// many.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "../base/dispatch.hpp"
#include "../base/geometry.hpp"

namespace minicloth {

constexpr int kSide = 4,
              kCells = kSide * kSide;  // cells along a block's side, in a block; the same of blocks in a group
constexpr int kPoints = (kSide + 1) * (kSide + 1);  // of a block: its cells' corners
constexpr int kCrowded = 64;                        // cells that one may be close to, on average
constexpr int kWide = 32;                           // the same with some to spare, which repeat the last one
constexpr int kBox = 12;                            // lo and hi x, y, z of points now, then of them at the end
constexpr int kRecord = 32;                         // numbers of a cell: its corners now, then at the end, and 8 unused
constexpr int kVertexParts = 4, kParts = 13;  // pairs of a vertex and a triangle, and all, of two cells: see parts

// Two blocks whose points may stray from their ways by `room` against each other before something else than what was
// found of them may be close; until one of them is searched anew. By `haste` [m/s] the speed may change at which their
// parts close until these are looked at again.
template <class T>
struct BlockPair {
  int a, b;
  T room, haste;
  bool live;
};
struct CellPair {
  int first, second, blocks;
};

// Cell (r, c) is numbered as the vertex at its upper left, and owns that vertex, the edges from it to the right, down
// and along the diagonal, and two triangles; in the last row and column some of these do not exist. Slot i of block or
// group b is number kCells * b + i, in row-major order inside it.
template <class T>
struct Sweep {
  int rows = 0, cols = 0;
  bool periodic = false;
  int block_rows, block_cols, group_rows, group_cols, groups, blocks;
  std::size_t plane;                   // numbers in a plane of vertices or cells, some to spare behind
  std::vector<int> at;                 // of every block its first cell, -1 where the sheet has none
  std::vector<int> point;              // kWide vertices of every block
  std::vector<std::uint16_t> exists;   // of every block: bit i if the sheet has its cell i
  std::vector<int> corner[4];          // vertices of every cell: upper left, upper right, lower left, lower right
  std::vector<std::int16_t> row, col;  // of every cell

  T most;               // m, see NearLanes::blocks
  T time, before, end;  // s: now, when boxes were last brought up to date, and until when ways are followed
  Plane<T> x, v;        // of vertices now, 3 planes each
  Plane<T> start, way;  // 3 rows of kWide of every block: where its points were at time 0, or would have been, m/s
  // Of cells: normals now and at the end, over their rest area; 1 where their triangles are nearly level with each
  // other, and where those of neighbours are as well, else -1.
  Plane<T> normal, later, plain, even;
  Plane<T> box, group, cone;  // kBox planes of blocks and of groups; 6 of blocks, the box of their normals
  Plane<T> shift;             // 4 planes of blocks: the middle of the box of how far points strayed, half its diagonal
  // Of blocks where `filled` says so: kBox rows of kCells, of their cells; of every cell of these kRecord numbers; bit
  // i of `level` where cell i is even.
  Plane<T> slots, records;
  std::vector<char> filled, fresh;  // fresh: only what these blocks meet is searched
  std::vector<std::uint16_t> level;
  std::vector<BlockPair<T>> pairs;
  std::vector<int> close;  // numbers of the pairs to look into
  std::vector<CellPair> cells;

  void shape(int rows, int cols, bool periodic);
  // Rows r0 to r1 - 1, columns c0 to c1 - 1 of a block's cells that have triangles; where it has none, the nearest
  // ones.
  struct Range {
    int r0, r1, c0, c1;
  };
  Range with_triangles(int block) const {
    const int r = row[at[block]], c = col[at[block]], down = rows - 1, across = periodic ? cols : cols - 1;
    const int r0 = r < down ? r : down - 1, c0 = c < across ? c : across - 1;
    return {r0, r0 + kSide < down ? r0 + kSide : down, c0, c0 + kSide < across ? c0 + kSide : across};
  }
  std::size_t row_of(int block, int axis) const { return (std::size_t(3) * block + axis) * kWide; }
};

// Two cells; bit 2 i + j: triangle i of the first, 0 the lower, 1 the upper, may cross triangle j of the second.
struct MeetingCells {
  int first, second;
  unsigned triangles;
};

// How often close parts are looked at: one that lies `far` apart and closes at a speed u, in
// (far - danger) / ((u + haste) h) steps, from 1 to kMostSteps. kAct says that it has to be kept apart before.
constexpr int kMostSteps = 32, kAct = 128;
constexpr double kTaken = 1;                        // of their room, from which blocks are searched anew
constexpr double kStart = 5, kCalm = 1, kWild = 5;  // m/s: haste of what was just found, and the least and the most
template <class T>
struct Looking {
  T reach, danger, h;  // m, m, s
};

// Of the parts of two cells: which to look at, as bits, and in how many steps first; which triangles may cross now, as
// in MeetingCells.
struct FirstLooks {
  std::uint16_t which;
  std::uint8_t meet;
  std::uint8_t wait[kParts];
};

// A vertex and a triangle, or two edges: elements of a field; the unit vector from the second to the first when they
// were last looked at, 0 before; the pair of blocks that they were found in.
template <class T>
struct Close {
  std::array<int, 4> at;
  T side[3];
  int owner;
  bool edges;    // two edges
  bool touched;  // kept apart before
};

template <class T>
struct NearLanes {
  // Of fresh blocks, from x and v: their ways from now on, boxes and normals.
  void (*boxes)(Sweep<T>&, T cell_area, bool all);
  // Pairs of blocks that have a fresh one: those nearer than near + room are close, up to near + most they are watched;
  // what is further apart may stray by half of `most` from the middle of all.
  void (*blocks)(Sweep<T>&, T near, T room, T most);
  void (*cells)(Sweep<T>&, T reach);
  // Of all cells found, those of their parts that do not stay apart by reach and room until the end. Parts 0, 1: vertex
  // of the first, lower and upper triangle of the second; 2, 3: the other way round; 4 + 3 a + b: edges a and b. What
  // may cross is found if `crossing` asks for it.
  void (*parts)(const Sweep<T>&, const Looking<T>&, T room, bool crossing, FirstLooks*);
  // Marks blocks as fresh that strayed from each other by kTaken of their room, and has haste of all as they strayed.
  // The largest part of its room that any took.
  T (*stray)(Sweep<T>&);
  // Of `count` pairs of parts, numbers in `parts`: when to look at each again. A pair whose vector turned round since
  // it was last looked at went through each other; its vector is the old way round.
  void (*look)(const T* x, const T* v, int width, const Sweep<T>&, Close<T>* parts, const int* which, int count,
               bool edges, const Looking<T>&, std::uint8_t* wait);
};
DECLARE_LANES(NearLanes<float>)
DECLARE_LANES(NearLanes<double>)

}  // namespace minicloth
