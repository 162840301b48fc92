#include "strips.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

namespace minicloth {

template <class T>
Strips<T>::Strips(int sheet_rows, int sheet_cols, double a, double b, bool periodic_, int width_, bool banded_)
    : width(width_), banded(banded_), periodic(periodic_) {
  const auto vectors = [&](int across, int along) { return (across + width - 1) / width * along; };
  turned = !periodic && vectors(sheet_cols, sheet_rows) < vectors(sheet_rows, sheet_cols);
  if (turned) std::swap(sheet_rows, sheet_cols), std::swap(a, b);
  rows = banded ? (sheet_rows + width - 1) / width : sheet_rows, cols = sheet_cols;
  stride = std::ptrdiff_t(cols + 2 * kGhost) * 3 * width, field = (rows + 2 * kGhost) * stride;
  row_length = T(a), col_length = T(b), diagonal = T(std::hypot(a, b)), twist = T(2 / (a * b));
  for (auto* v : {&along, &down, &shear, &bend_along, &bend_down, &inverse_area, &inside, &cell})
    v->assign(std::size_t(rows) * width, T(0));
  const int across = turned ? sheet_cols : sheet_rows, along_row = turned ? sheet_rows : sheet_cols;
  for (int i = 0; i < across * along_row; ++i) {
    const int row = turned ? i % along_row : i / along_row, col = turned ? i / along_row : i % along_row;
    places.push_back(int(banded ? at(row % rows, col) + row / rows : at(row, col)));
  }
  order.resize(places.size());
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [&](int i, int j) { return places[i] < places[j]; });
  for (int r = 0; r < rows; ++r)
    for (int l = 0; l < width; ++l) {
      const int row = banded ? l * rows + r : r, i = r * width + l;
      if (row >= sheet_rows) continue;
      const bool first = row == 0, last = row == sheet_rows - 1;
      const double share = first || last ? 0.5 : 1;
      along[i] = T(share * a / b), bend_along[i] = T(share * a / (b * b * b));
      inverse_area[i] = T(1 / (a * b * share)), inside[i] = T(1);
      if (!first && !last) bend_down[i] = T(b / (a * a * a));
      if (last) continue;
      down[i] = T(b / a), shear[i] = T((a * a + b * b) / (2 * a * b)), cell[i] = T(1);
    }
}

template struct Strips<float>;
template struct Strips<double>;

}  // namespace minicloth
