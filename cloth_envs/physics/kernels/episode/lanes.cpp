// Whether a state is sound. Compiled once per instruction set; LANES names the namespace.
#include <cmath>

#include "../base/simd.hpp"
#include "core.hpp"

namespace minicloth {
namespace LANES {
namespace {

// The longest of some edges: a vector of them at a time, whose last one holds some of the one before again.
template <class T>
struct Longest {
  V<T> most = {};
  T few = 0;  // of fewer edges than a vector has, one by one

  // `count` edges from x on to the vertices `step` further; planes are n apart.
  void add(const T* x, int step, int count, int n) {
    if (count < kLanes<T>) {
      for (int k = 0; k < count; ++k) {
        const T a = x[k + step] - x[k], b = x[k + step + n] - x[k + n], c = x[k + step + 2 * n] - x[k + 2 * n];
        const T d = a * a + b * b + c * c;
        few = few > d ? few : d;
      }
      return;
    }
    for (int next = 0; next < count; next += kLanes<T>) {
      const T *from = x + (next < count - kLanes<T> ? next : count - kLanes<T>), *to = from + step;
      const V<T> a = load(to) - load(from), b = load(to + n) - load(from + n);
      const V<T> c = load(to + 2 * n) - load(from + 2 * n), d = a * a + b * b + c * c;
      most = most > d ? most : d;
    }
  }
  T square() const {
    T all = few;
    for (int l = 0; l < kLanes<T>; ++l) all = all > most[l] ? all : most[l];
    return all;
  }
};

template <class T>
Check check(const T* x, const T* v, int rows, int cols, T row_length, T col_length, bool periodic) {
  const int n = rows * cols;
  V<T> bad[2] = {}, square[2] = {};  // two of each, or every addition would wait for the one before
  T bad1 = 0, square1 = 0;
  int i = 0;
  for (; i + 2 * kLanes<T> <= 3 * n; i += 2 * kLanes<T>)
    for (int k = 0; k < 2; ++k) {
      const V<T> at = load(x + i + k * kLanes<T>), speed = load(v + i + k * kLanes<T>);
      bad[k] += at * T(0);  // NaN unless finite
      square[k] += speed * speed;
    }
  for (; i < 3 * n; ++i) bad1 += x[i] * T(0), square1 += v[i] * v[i];
  Longest<T> down, along;
  down.add(x, cols, n - cols, n);
  for (int r = 0; r < rows; ++r) {
    along.add(x + r * cols, 1, cols - 1, n);
    if (periodic) along.add(x + r * cols + cols - 1, 1 - cols, 1, n);
  }
  const double stretch = std::fmax(double(down.square()) / (double(row_length) * row_length),
                                   double(along.square()) / (double(col_length) * col_length));
  for (int l = 0; l < kLanes<T>; ++l) bad1 += bad[0][l] + bad[1][l], square1 += square[0][l] + square[1][l];
  return {std::isfinite(bad1) && std::isfinite(square1), std::sqrt(stretch) - 1, 0.5 * double(square1) / n};
}

template <class T>
const StateLanes<T> table = {check<T>};

}  // namespace
}  // namespace LANES

DEFINE_LANES(StateLanes<float>, table<float>)
DEFINE_LANES(StateLanes<double>, table<double>)

}  // namespace minicloth
