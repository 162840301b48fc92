// A network that adds detail to cloth interpolated at half its spacing.
#pragma once
#include <vector>

#include "../base/dispatch.hpp"
#include "dense.hpp"
#include "resample.hpp"

namespace minicloth {

constexpr int kPoints = 12;  // of a patch, 4 x 4 coarse vertices without the corners
constexpr int kNodes = 9;    // that a cell spans at half the spacing, 3 x 3

struct PatchNet {
  float spacing;  // m, of coarse vertices
  float limit;    // of a residual, in spacings
  std::vector<DenseLayer<9>> layers;
  int biases;  // of all layers, one after the other
};

struct PatchLanes {
  // Coarse positions (3, rows, cols) at half the spacing, (3, 2 rows - 1, 2 cols - 1): bicubic and the residual.
  void (*upscale)(const PatchNet&, const float* x, int rows, int cols, const float* bias, float* out);
};
DECLARE_LANES(PatchLanes)

// Coarse positions (3, rows, cols) at half the spacing, or what `finer` (or null) makes of that.
void upscale(const PatchNet& net, const float* x, int rows, int cols, const float* bias, const Grids* finer,
             float* out);

}  // namespace minicloth
