#include "geometry.hpp"

#include <algorithm>
#include <cmath>

namespace minicloth {

template <class T>
Geometry<T>::Geometry(int rows_, int cols_, double a, double b, bool periodic_)
    : rows(rows_),
      cols(cols_),
      stride(std::max(cols_ + (periodic_ ? 2 : 1) * kGhost, kBlock + 2)),
      periodic(periodic_),
      row_length(T(a)),
      col_length(T(b)),
      diagonal(T(std::hypot(a, b))),
      twist_along(T(4 / (a * a))),
      twist_down(T(4 / (b * b))),
      twist_diagonal(T(-4 / (a * a + b * b))) {
  begin = (kGhost * stride + 2 * kBlock) / kBlock * kBlock;
  origin = begin + (periodic ? kGhost : 0);
  end = begin + (at(rows - 1, cols) - begin + kBlock - 1) / kBlock * kBlock;
  size = std::size_t(end + kGhost * stride + 2 * kBlock) / kBlock * kBlock;
  for (auto* v : {&along, &down, &right, &left, &along_near, &down_near, &along_far, &down_far, &inverse_area, &cell})
    v->assign(size, T(0));

  const int first = periodic ? -kGhost : 0, last = periodic ? cols + kGhost : cols;  // columns with weights
  const auto row_share = [&](int r) { return r == 0 || r == rows - 1 ? 0.5 : 1.0; };
  const auto col_share = [&](int c) { return !periodic && (c == 0 || c == cols - 1) ? 0.5 : 1.0; };
  const auto has_col = [&](int c) { return c >= first && c < last; };
  // Weight of the squared second difference at a vertex, 0 where a neighbour is missing.
  const auto bend_along = [&](int r, int c) {
    return has_col(c) && (periodic || (c > 0 && c < cols - 1)) ? row_share(r) * a / (b * b * b) : 0.0;
  };
  const auto bend_down = [&](int r, int c) { return r > 0 && r < rows - 1 ? col_share(c) * b / (a * a * a) : 0.0; };
  const double shear = (a * a + b * b) / (2 * a * b);

  for (int r = 0; r < rows; ++r)
    for (int c = first; c < last; ++c) {
      const int i = at(r, c);
      const bool next_col = has_col(c + 1), prev_col = has_col(c - 1), next_row = r + 1 < rows;
      if (c >= 0 && c < cols) inverse_area[i] = T(1 / (a * b * row_share(r) * col_share(c)));
      if (next_col) {
        along[i] = T(row_share(r) * a / b);
        along_near[i] = T(2 * (bend_along(r, c) + bend_along(r, c + 1)));
      }
      if (has_col(c + 2)) along_far[i] = T(-bend_along(r, c + 1));
      if (next_row) {
        down[i] = T(col_share(c) * b / a);
        down_near[i] = T(2 * (bend_down(r, c) + bend_down(r + 1, c)));
        if (next_col) right[i] = T(shear);
        if (prev_col) left[i] = T(shear);
        if (next_col) cell[i] = T(1);
      }
      if (r + 2 < rows) down_far[i] = T(-bend_down(r + 1, c));
    }
}

template <class T>
void Geometry<T>::pad(const T* field, T* const (&planes)[3]) const {
  for (T* plane : planes)
    for (int r = 0; r < rows; ++r, field += cols) std::copy_n(field, cols, plane + at(r, 0));
}

template <class T>
void Geometry<T>::unpad(T* const (&planes)[3], T* field) const {
  for (const T* plane : planes)
    for (int r = 0; r < rows; ++r, field += cols) std::copy_n(plane + at(r, 0), cols, field);
}

template <class T>
void Geometry<T>::wrap(T* const (&planes)[3]) const {
  if (!periodic) return;
  for (T* plane : planes)
    for (int r = 0; r < rows; ++r) {
      T* row = plane + at(r, 0);
      for (int k = 1; k <= kGhost; ++k) row[-k] = row[cols - k], row[cols + k - 1] = row[k - 1];
    }
}

template struct Geometry<float>;
template struct Geometry<double>;

}  // namespace minicloth
