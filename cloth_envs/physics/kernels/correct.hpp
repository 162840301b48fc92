// A network that corrects the coarse cloth after every frame; surrogates/dynamics.py says what it reads and answers.
#pragma once
#include <vector>

#include "geometry.hpp"

namespace nanobind {
class module_;
}

namespace minicloth {

constexpr int kTogether = 8;       // outputs of a layer that are summed together
constexpr int kMostNumbers = 256;  // that a layer may have
constexpr int kCorrectLayers = 3;

// The weight of input f to output kTogether * b + k is weights[(b * inputs + f) * kTogether + k].
struct CorrectLayer {
  int inputs, outputs;
  Plane<float> weights, bias;
};

struct Correct {
  int vertices, padded;        // padded to whole blocks: the last vertex again
  int near, moving, changing;  // neighbours whose positions, velocities and changes of velocity are read
  std::vector<int> index;      // (near + moving + changing, padded)
  std::vector<float> nearer;   // (near,) factors of positions
  int places;
  Plane<float> place;  // (places, padded)
  Plane<float> share;  // (padded,)
  Plane<float> low, high;
  float limit[6];
  float spacing, frame_dt;
  bool wind;
  std::vector<bool> planes;
  std::vector<float> radii;
  CorrectLayer layers[kCorrectLayers];
};

struct Air {
  const float *wind, *bodies;  // (3,) and (C, 2, 3)
};

// Corrects x and v, (3, V) each, of one cloth in place; old are the velocities before the frame.
using Corrects = void (*)(const Correct&, const float* old, const Air&, float* x, float* v);

Corrects best_correct();
void bind_correct(nanobind::module_& m);

}  // namespace minicloth
