// A network that corrects the coarse cloth after every frame; surrogates/miniature/correction.py says what it reads and
// answers.
#pragma once
#include <vector>

#include "../base/dispatch.hpp"
#include "dense.hpp"

namespace minicloth {

constexpr int kCorrectLayers = 3;

struct Correct {
  int vertices, width;         // padded to whole blocks: the last vertex again
  int near, moving, changing;  // neighbours whose positions, velocities and changes of velocity are read
  std::vector<int> index;      // (near + moving + changing, width)
  std::vector<float> nearer;   // (near,) factors of positions
  int places;
  Plane<float> place;  // (places, width)
  Plane<float> share;  // (width,)
  Plane<float> low, high;
  float limit[6];
  float spacing, frame_dt;
  bool wind;
  std::vector<bool> planes;
  std::vector<float> radii;
  DenseLayer<8> layers[kCorrectLayers];
  Plane<float> biases[kCorrectLayers];
};

struct Surroundings {
  const float *wind, *bodies;  // (3,) and (C, 2, 3)
};

struct CorrectLanes {
  // Corrects x and v, (3, V) each, of one cloth in place; old are the velocities before the frame.
  void (*correct)(const Correct&, const float* old, const Surroundings&, float* x, float* v);
};
DECLARE_LANES(CorrectLanes)

}  // namespace minicloth
