// Keeps upscaled vertices out of bodies.
#pragma once
#include <vector>

#include "../base/dispatch.hpp"

namespace minicloth {

struct UpscaledBody {
  bool plane;  // ends[0] is a point, ends[1] the unit normal
  float ends[2][3], velocities[2][3];
  float radius;  // includes the thickness
};

struct Pushed {
  int count;
  float depth;  // of the deepest, m
};

struct ProjectionLanes {
  // Puts those of n vertices (3, n) that are in bodies on their surfaces: one body after the other, twice where there
  // are several. How many were in a body the first time.
  Pushed (*push)(const std::vector<UpscaledBody>&, int n, float* x);
  // Takes from vertices within `reach` of surfaces the velocity into them.
  void (*stop)(const std::vector<UpscaledBody>&, int n, const float* x, float* v, float reach);
};
DECLARE_LANES(ProjectionLanes)

}  // namespace minicloth
