// The explicit solver: frames of symplectic Euler substeps for a batch of cloths.
#pragma once
#include <utility>
#include <vector>

#include "../base/dispatch.hpp"
#include "../base/geometry.hpp"
#include "../sheet/air.hpp"
#include "../sheet/bodies.hpp"
#include "../sheet/sheet.hpp"

namespace minicloth {

// Forces of the edges that leave every vertex towards row + 1 and both diagonals, and (in narrow grids) the sum of
// what a vertex feels without those that arrive from the row above; 0 before Geometry::begin.
template <class T>
struct Edges {
  T *sum[3], *down[3], *right[3], *left[3];
  int ring;  // an element's place is its number modulo this; the first block is repeated after the last
};

template <class T>
struct StepTerms {
  T stretch, shear, bend, damping;            // N/m, N/m, N m, s
  T twist_along, twist_down, twist_diagonal;  // N/m; times the edges' weights, see Geometry
  T yields, buckled, buckling;                // of a shortened spring: see core.cpp
  T shortened_damping;                        // s
  T accelerate, decay, dt, gravity_kick;      // force/area -> dv, v factor, s, dv of gravity
};

template <class T>
struct ExplicitLanes {
  // One substep of springs, dampers, bending, gravity, drag and the listed forces of the air.
  using Step = void (*)(const Geometry<T>&, const StepTerms<T>&, const Planes<T>& in, const Planes<T>& out,
                        const Cells<T>& air, const Edges<T>& edges);
  Step step[2][2];  // [springs yield under compression][air]
  using Air = void (*)(const Geometry<T>&, const AirTerms<T>&, const Planes<T>& in, const Cells<T>& out);
  Air air[2];  // [air's resistance]; pressure alone needs no velocities
  void (*contact)(const Geometry<T>&, const BodyStep<T>&, const Planes<T>& in, const Planes<T>& out);
};
DECLARE_LANES(ExplicitLanes<float>)
DECLARE_LANES(ExplicitLanes<double>)

template <class T>
class Explicit {
 public:
  explicit Explicit(Sheet sheet);
  // Frames of some cloths, each of its own material in its own number of substeps. Results do not depend on threads.
  void advance(const std::vector<Frame<T>>& frames, const std::vector<Material>& materials, const int* substeps,
               int threads) const;
  const Sheet& sheet() const { return sheet_; }

 private:
  void advance(const Frame<T>& frame, const Material& material, int substeps) const;
  Sheet sheet_;
  Geometry<T> geometry_;
};

}  // namespace minicloth
