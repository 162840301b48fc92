#include "edges.hpp"

#include <cmath>

namespace minicloth {

Weave::Weave(int rows_, int cols_, bool periodic, double row_length, double col_length, double shear, double shorter,
             double shear_shorter)
    : rows(rows_),
      cols(cols_),
      width((cols_ + 1) / 2),
      plane(padded((rows_ + 1) / 2 * ((cols_ + 1) / 2) + 1) + kBlock),
      even_(plane),
      odd_(plane),
      periodic_(periodic) {
  for (int r = 0; r < (rows + 1) / 2; ++r)
    for (int k = 0; k < width; ++k)
      even_[r * width + k] = 2 * k + 1 < cols, odd_[r * width + k] = 2 * k + 2 < cols;
  const float along = float(col_length), down = float(row_length), across = float(std::hypot(row_length, col_length));
  // From rows `r` and columns `c`, even (0) or odd (1), to the row and the column next to them.
  const auto add = [&](int r, int c, bool next_row, bool next_col, bool falling, float length, float longer,
                       float less) {
    const int pairs = next_row ? (rows - r) / 2 : (rows + 1 - r) / 2;
    const auto vertex = [&](int row, int col) {
      return (row % 2 * 2 + col % 2) * plane + row / 2 * width + col / 2;
    };
    const int from = falling ? vertex(r, c) : vertex(r, c + 1), to = falling ? vertex(r + next_row, c + next_col) : vertex(r + next_row, c);
    loops.push_back({from, to, pairs * width, next_col ? (c ? odd_ : even_).data() : nullptr, length, longer, less});
  };
  for (int r = 0; r < 2; ++r)
    for (bool falling : {true, false})
      for (int c = 0; c < 2; ++c) add(r, c, true, true, falling, across, float(shear), float(shear_shorter));
  for (int c = 0; c < 2; ++c)
    for (int r = 0; r < 2; ++r) add(r, c, false, true, true, along, 1, float(shorter));
  for (int r = 0; r < 2; ++r)
    for (int c = 0; c < 2; ++c) add(r, c, true, false, true, down, 1, float(shorter));
}

}  // namespace minicloth
