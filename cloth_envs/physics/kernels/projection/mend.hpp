// Brings the edges of upscaled cloths to their lengths at rest: see surrogates/miniature/mending.py.
#pragma once
#include <cstddef>

#include "../base/dispatch.hpp"

namespace minicloth {

struct Mending {
  int rows, cols, sweeps;
  float row_length, col_length;  // m
  float slack, shorter, wave, buckling;
};

struct MendLanes {
  // Positions (3, rows, cols), of which vertices `held` stay.
  void (*mend)(const Mending&, const int* held, std::size_t count, float* x);
};
DECLARE_LANES(MendLanes)

}  // namespace minicloth
