// A network that adds detail to cloth interpolated at a quarter of its spacing: 3 x 3 convolutions over the coarse
// grid.
#pragma once
#include <vector>

#include "../base/dispatch.hpp"
#include "../base/geometry.hpp"
#include "dense.hpp"
#include "resample.hpp"

namespace minicloth {

constexpr int kTaps9 = 9;                    // of a convolution
constexpr int kScale = 4;                    // fine cells along each side of a coarse one
constexpr int kVectors = 13;                 // surrogates/superres/features.py says which
constexpr int kChannels = 3 * kVectors + 2;  // and the numbers

struct DetailNet {
  int rows, cols;  // of the coarse grid
  bool periodic;
  float spacing, limit, reach;        // m; of a residual and of bodies, in spacings
  Plane<float> mean, per, held;       // of the channels: means and inverse widths; 1 at driven vertices, else 0
  std::vector<DenseLayer<4>> layers;  // from inputs * 9 numbers, tap after tap
  std::vector<Plane<float>> biases;
  Plane<float> radii;  // m, of bodies, with the thickness of contact
  std::vector<bool> planes;
  Grids finer;  // linear, of axes

  int fine_rows() const { return kScale * (rows - 1) + 1; }
  int fine_cols() const { return periodic ? kScale * cols : kScale * (cols - 1) + 1; }
};

struct DetailLanes {
  // Adds the residual of coarse positions (3, rows, cols) of the last three frames, among bodies (C, 2, 3) at the last
  // two of them, to fine ones.
  void (*add)(const DetailNet&, const float* now, const float* before, const float* earlier, const float* bodies,
              const float* bodies_before, float* fine);
};
DECLARE_LANES(DetailLanes)

}  // namespace minicloth
