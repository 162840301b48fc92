// The grid as flat, padded arrays: what every kernel indexes.
#pragma once
#include <cstddef>
#include <vector>

namespace minicloth {

// A vertex (r, c) is element (r + 2) * stride + c + kLead. Two ghost rows lie above and below and at
// least two ghost columns between rows, so that a neighbour up to distance two is a constant offset.
// Edges that do not exist have weight 0, which makes masks unnecessary.
constexpr int kGhost = 2;
constexpr int kLead = 16;   // keeps negative offsets inside the buffer
constexpr int kBlock = 16;  // loops run over whole blocks, the tail lies in ghosts; a row is longer than one

template <class T>
struct Geometry {
  int rows, cols, stride, begin, end;
  std::size_t size;
  bool periodic;
  T row_length, col_length, diagonal;
  // Spring weights; times stretch (along, down) or shear (right, left) they are stiffnesses [N/m].
  std::vector<T> along, down, right, left;
  // Bending as linear edges over distance one (near) and two (far); times bend_stiffness, [N/m].
  std::vector<T> along_near, down_near, along_far, down_far;
  std::vector<T> inverse_area;  // 1/m^2, 0 in ghosts
  std::vector<T> cell;          // 1 where a cell's upper left corner is, else 0

  Geometry(int rows, int cols, double row_length, double col_length, bool periodic);
  int at(int r, int c) const { return (r + kGhost) * stride + c + kLead; }
};

}  // namespace minicloth
