// Which triangles of one cloth may cross each other where it lies: first blocks of cells by their boxes, then cells by
// theirs, then triangles by the planes of each other. All of it errs towards too many.
#pragma once
#include <cstdint>
#include <vector>

#include "../base/dispatch.hpp"
#include "../base/geometry.hpp"
#include "../selfcontact/near.hpp"

namespace minicloth {

// Of a sheet of one shape; keeps its memory from cloth to cloth. Vertex and cell (r, c) are number r * stride + 1 + c
// of their planes, so that there is room for what lies beside them. Blocks of 4 x 4 cells are numbered row by row; a
// strip is of kBlock blocks.
struct Meeting {
  int rows = 0, cols = 0, down, across, stride, block_rows, block_cols, blocks, strips;
  bool periodic = false;
  std::size_t plane;
  float twice;                    // m^2, the area of a cell at rest times two, which normals have
  std::vector<int> number;        // of elements of the planes: which vertex of the sheet lies there
  Plane<float> x, moved;          // 3 planes of vertices; 1 of those that are looked at
  Plane<float> low, high;         // 3 planes each of cells: their boxes
  Plane<float> normal, lower;     // the same, the sums of their triangles' normals, and those of the lower ones
  Plane<float> plain, even;       // of cells: 1 where triangles are nearly level, and where those beside it are as well
  Plane<float> box, cone, strip;  // 6 planes, lo and hi, of blocks, of their triangles' normals, of strips
  std::vector<char> fresh, fresh_rows, filled;  // of blocks, of their rows: with vertices that moved
  Plane<float> slots;                           // of blocks where `filled` says so: 6 rows of their cells' boxes
  std::vector<std::uint16_t> level, moves;      // of the same, bit i where cell i is even, and where it moved
  std::vector<int> pairs[2];                    // cells whose boxes meet
  std::vector<MeetingCells> cells;              // what was found

  void shape(int rows, int cols, bool periodic, double cell_area);
};

struct MeetLanes {
  // Finds what may cross of positions (3, rows, cols): all, or only where a vertex moved since the last time or where
  // `mark` (rows, cols) is positive.
  void (*find)(Meeting&, const float* x, const float* mark, bool all);
};
DECLARE_LANES(MeetLanes)

}  // namespace minicloth
