// The sheet as vectors whose lanes are bands of its rows, or cloths of a batch: neighbours lie whole vectors apart.
#pragma once
#include <cstddef>

#include "../base/geometry.hpp"

namespace minicloth {

// Vertex (row, col) of lane `l`, axis k is element at(row, col) + k * width + l of a field. Lane l of a banded sheet
// starts with row l * rows. Around the rows and columns of a lane lie kGhost more: of a band those of its neighbours,
// of a tube those on its other side, else zeros, which have no weight.
template <class T>
struct Strips {
  int width;                     // lanes
  bool banded;                   // lanes are bands, else cloths
  bool turned;                   // rows are the sheet's columns: so it fills the lanes better
  bool periodic;                 // columns go round
  int rows, cols;                // of a lane
  std::ptrdiff_t stride, field;  // elements from a row to the next, of a field
  T row_length, col_length, diagonal;
  // Of every row and lane (width elements a row, 0 off the sheet). Times stretch (along, down) or shear they are a
  // spring's stiffness [N/m], times bend_stiffness (bend_along, bend_down) a second difference's. What runs down is
  // half of that in the columns at an open border.
  Plane<T> along, down, shear, bend_along, bend_down;
  Plane<T> inverse_area, inside, cell;  // 1/m^2, 1, 1 where cells begin
  T twist;                              // of a cell's mixed difference, 1/m^2

  // Of every vertex its element, axis 0 (of cloth m it lies m further); and vertices in the order of their elements.
  std::vector<int> places, order;

  Strips(int sheet_rows, int sheet_cols, double row_length, double col_length, bool periodic, int width, bool banded);
  std::ptrdiff_t at(int row, int col) const { return (row + kGhost) * stride + (col + kGhost) * 3 * width; }
};

}  // namespace minicloth
