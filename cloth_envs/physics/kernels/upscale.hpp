// A network that adds detail to cloth interpolated at half its spacing, and what keeps upscaled vertices out of bodies.
#pragma once
#include <vector>

#include "geometry.hpp"

namespace nanobind {
class module_;
}

namespace minicloth {

constexpr int kPoints = 12;   // of a patch, 4 x 4 coarse vertices without the corners
constexpr int kNodes = 9;     // that a cell spans at half the spacing, 3 x 3
constexpr int kUnits = 9;     // outputs of a layer that are summed together
constexpr int kWidest = 256;  // numbers that a layer may have

// A dense layer. The weight of input f to output kUnits * b + k is weights[(b * inputs + f) * kUnits + k].
struct DenseLayer {
  int inputs, outputs;
  Plane<float> weights;
};

struct PatchNet {
  float spacing;  // m, of coarse vertices
  float limit;    // of a residual, in spacings
  std::vector<DenseLayer> layers;
  int biases;  // of all layers, one after the other
};

struct UpscaledBody {
  bool plane;  // ends[0] is a point, ends[1] the unit normal
  float ends[2][3], velocities[2][3];
  float radius;  // includes the thickness
};

struct Pushed {
  int count;
  float depth;  // of the deepest, m
};

struct UpscaleLanes {
  // Coarse positions (3, rows, cols) at half the spacing, (3, 2 rows - 1, 2 cols - 1): bicubic and the residual.
  void (*upscale)(const PatchNet&, const float* x, int rows, int cols, const float* bias, float* out);
  // Puts those of n vertices (3, n) that are in the body on its surface.
  Pushed (*push)(const UpscaledBody&, int n, float* x);
  // Takes from vertices within `reach` of the body's surface the velocity into it.
  void (*stop)(const UpscaledBody&, int n, const float* x, float* v, float reach);
};

const UpscaleLanes& best_upscale_lanes();
void bind_upscale(nanobind::module_& m);

}  // namespace minicloth
