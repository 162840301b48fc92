// How far cells are sheared. Included where it is compiled for an instruction set.
#pragma once
#include <algorithm>
#include <cstring>

#include "../base/simd.hpp"

namespace minicloth {
namespace LANES {
namespace {

// Of vertices in the lanes of W: what leads from the one above to the one below times what leads from left to right.
template <class W, class T>
inline W slant(const T* x, std::ptrdiff_t vertices, std::ptrdiff_t cols) {
  W product = {};
  for (int k = 0; k < 3; ++k, x += vertices) {
    W up, down, left, right;
    std::memcpy(&up, x - cols, sizeof up), std::memcpy(&down, x + cols, sizeof down);
    std::memcpy(&left, x - 1, sizeof left), std::memcpy(&right, x + 1, sizeof right);
    product += (down - up) * (right - left);
  }
  return product < 0 ? -product : product;
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
      most = found > most ? found : most;
    }
    for (; c + few < cols; c += few) {
      const Short found = slant<Short>(row + c, rows * cols, cols);
      some = found > some ? found : some;
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
