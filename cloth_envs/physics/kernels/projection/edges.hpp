// Brings the edges of upscaled cloths to their lengths at rest.
#pragma once
#include <cstddef>
#include <vector>

#include "../base/dispatch.hpp"
#include "../base/geometry.hpp"

namespace minicloth {

// Edges of one kind between the vertices of two planes: from[i] to to[i]. `shares` are 0 where there is none.
struct Edges {
  int from, to, count;
  const float* shares;
  float length, longer, shorter;  // m; how much of its strain an edge loses in a sweep
};

// The vertices of a grid in four planes, by whether row and column are even or odd, so that no two edges of one loop
// share a vertex and all lie side by side. What a sweep does, one loop after the other.
class Weave {
 public:
  Weave(int rows, int cols, bool periodic, double row_length, double col_length, double shear, double shorter,
        double shear_shorter);
  std::size_t size() const { return 4 * std::size_t(plane); }
  int at(int r, int c) const { return (r % 2 * 2 + c % 2) * plane + r / 2 * width + c / 2; }

  int rows, cols, width, plane;  // of each plane: its row, the whole
  std::vector<Edges> loops;

 private:
  Plane<float> even_, odd_;  // whether there is a vertex to the right of one in an even, in an odd column
  bool periodic_;
};

struct EdgeLanes {
  // x (3, n) goes on from x + keep * offset, whose vertices `held` are those of x; offset becomes what x moved by.
  void (*mend)(const Weave&, int sweeps, float keep, const int* held, std::size_t count, float* x, float* offset);
};
DECLARE_LANES(EdgeLanes)

}  // namespace minicloth
