// Whether a state is sound. Compiled once per instruction set; LANES names the namespace.
#include <cmath>

#include "../base/simd.hpp"
#include "core.hpp"

namespace minicloth {
namespace LANES {
namespace {

template <class T>
Check check(const T* x, const T* v, int rows, int cols, T row_length, T col_length, bool periodic) {
  const int n = rows * cols;
  const V<T> zero = {};
  V<T> bad = zero, square = zero;
  T bad1 = 0, square1 = 0;
  int i = 0;
  for (; i + kLanes<T> <= 3 * n; i += kLanes<T>) {
    bad += load(x + i) * T(0);  // NaN unless finite
    square += load(v + i) * load(v + i);
  }
  for (; i < 3 * n; ++i) bad1 += x[i] * T(0), square1 += v[i] * v[i];
  const auto longest = [&](int from, int step, int count, T scale) {
    V<T> most = zero;
    T most1 = 0;
    int k = from;
    for (; k + kLanes<T> <= from + count; k += kLanes<T>) {
      const V<T> a = load(x + k + step) - load(x + k), b = load(x + k + step + n) - load(x + k + n);
      const V<T> c = load(x + k + step + 2 * n) - load(x + k + 2 * n), d = a * a + b * b + c * c;
      most = most > d ? most : d;
    }
    for (; k < from + count; ++k) {
      const T a = x[k + step] - x[k], b = x[k + step + n] - x[k + n], c = x[k + step + 2 * n] - x[k + 2 * n];
      const T d = a * a + b * b + c * c;
      most1 = most1 > d ? most1 : d;
    }
    for (int l = 0; l < kLanes<T>; ++l) most1 = most1 > most[l] ? most1 : most[l];
    return double(most1) * double(scale);
  };
  const T along = 1 / (col_length * col_length), down = 1 / (row_length * row_length);
  double stretch = longest(0, cols, n - cols, down);
  for (int r = 0; r < rows; ++r) {
    stretch = std::fmax(stretch, longest(r * cols, 1, cols - 1, along));
    if (periodic) stretch = std::fmax(stretch, longest(r * cols + cols - 1, 1 - cols, 1, along));
  }
  for (int l = 0; l < kLanes<T>; ++l) bad1 += bad[l], square1 += square[l];
  return {std::isfinite(bad1) && std::isfinite(square1), std::sqrt(stretch) - 1, 0.5 * double(square1) / n};
}

template <class T>
const StateLanes<T> table = {check<T>};

}  // namespace
}  // namespace LANES

DEFINE_LANES(StateLanes<float>, table<float>)
DEFINE_LANES(StateLanes<double>, table<double>)

}  // namespace minicloth
