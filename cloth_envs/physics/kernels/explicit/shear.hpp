// How far cells are sheared. Included where it is compiled for an instruction set.
#pragma once
#include <algorithm>
#include <cstring>

#include "../base/simd.hpp"

namespace minicloth {
namespace LANES {
namespace {

template <class W>
inline W larger(const W& a, const W& b) {
  return a > b ? a : b;
}
template <class W>
inline W size(const W& a) {
  return a < 0 ? -a : a;
}

// Of vertices in the lanes of W: at their four corners, what leads down times what leads to the right, added with the
// signs that make most of it: all alike, or other ones above than below, to the left than to the right, or both.
template <class W, class T>
inline W slant(const T* x, std::ptrdiff_t vertices, std::ptrdiff_t cols) {
  W alike = {}, rows = {}, columns = {}, both = {};
  for (int k = 0; k < 3; ++k, x += vertices) {
    W at, up, down, left, right;
    std::memcpy(&at, x, sizeof at);
    std::memcpy(&up, x - cols, sizeof up), std::memcpy(&down, x + cols, sizeof down);
    std::memcpy(&left, x - 1, sizeof left), std::memcpy(&right, x + 1, sizeof right);
    const W twice = at + at, fall = down - up, along = right - left;
    const W sag = (up + down) - twice, bow = (left + right) - twice;
    alike += fall * along, rows += sag * along, columns += fall * bow, both += sag * bow;
  }
  return larger(larger(size(alike), size(rows)), larger(size(columns), size(both)));
}

// The largest of the inner vertices of positions (3, H, W) [m^2]; NaN does not count. What is left of a row by whole
// vectors goes in short ones, for small cloths have little else.
template <class T>
T slant(int height, int width, const T* x) {
  typedef T Short __attribute__((vector_size(16)));
  constexpr int n = kLanes<T>, few = 16 / int(sizeof(T));
  const std::ptrdiff_t rows = height, cols = width;
  V<T> most = {};
  Short some = {};
  T last = 0;
  for (std::ptrdiff_t r = 1; r < rows - 1; ++r) {
    const T* const row = x + r * cols;
    std::ptrdiff_t c = 1;
    for (; c + n < cols; c += n) {
      const V<T> found = slant<V<T>>(row + c, rows * cols, cols);
      most = larger(found, most);
    }
    for (; c + few < cols; c += few) {
      const Short found = slant<Short>(row + c, rows * cols, cols);
      some = larger(found, some);
    }
    for (; c < cols - 1; ++c) last = std::max(last, slant<T>(row + c, rows * cols, cols));
  }
  for (int l = 0; l < n; ++l) last = std::max(last, T(most[l]));
  for (int l = 0; l < few; ++l) last = std::max(last, T(some[l]));
  return last;
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
