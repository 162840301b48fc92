// Interpolation of fields on a grid to another one, along columns and then along rows.
#pragma once
#include <cstddef>
#include <vector>

#include "../base/dispatch.hpp"

namespace minicloth {

constexpr int kTaps = 4;

// Every one of `count` new samples is a sum of old ones: tap t of c is number index[t * stride + c], weight alike. Up
// to whole blocks, the last sample is there again.
struct Taps {
  int taps, count, stride;
  std::vector<int> index;
  std::vector<float> weight;
};

struct ResampleLanes {
  // Planes (h, w) of `in` to planes (rows.count, cols.count) of `out`.
  void (*resample)(const float* in, int planes, int h, int w, const Taps& rows, const Taps& cols, float* out);
};
DECLARE_LANES(ResampleLanes)

// out = R field C^T for planes (h, w): every new row or column is a weighted sum of some old ones.
struct Grids {
  int h, w;
  Taps rows, cols;
  void operator()(const float* in, int planes, float* out) const {
    lanes<ResampleLanes>().resample(in, planes, h, w, rows, cols, out);
  }
};

// Vertices that take their pull of what is missing at a driven vertex, the one of this number.
struct Pulled {
  const int *near, *guides;
  const float* pull;
  std::size_t count;
};

// Puts the vertices `held` of (3, n) to the rows `numbers` of driven (N, 3). Where one is off by more than `rounding`,
// those near it follow.
void place(float* field, std::size_t n, const double* driven, const int* numbers, const int* held, std::size_t count,
           const Pulled& pulled, double rounding);

}  // namespace minicloth
