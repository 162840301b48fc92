// The explicit solver: frames of symplectic Euler substeps for a batch of cloths.
#pragma once
#include <vector>

#include "lanes.hpp"

namespace minicloth {

struct Body {
  bool plane;
  double radius, friction;
};

// What the whole batch shares.
struct World {
  double frame_dt, gravity, thickness;
  double wind_normal, wind_tangential;  // air density * coefficient [kg/m^3]
  bool wind, pressure;
  std::vector<int> handles;  // vertex numbers
  std::vector<Body> bodies;
};

// One cloth's material: kg/m^2, N/m, N/m, N m, s, 1/s, 1, 1, 1, 1.
struct Sheet {
  static constexpr std::size_t kProperties = 10;
  double density, stretch, shear, bend, damping, drag;
  double compression = 1, buckling_strain = 1, post_buckling = 1, compression_damping = 1;
  bool yields() const { return compression != 1 || post_buckling != 1 || compression_damping != 1; }
};

// One cloth's frame. Arrays (3, H, W), (N, 3) and (C, 2, 3).
template <class T>
struct Frame {
  const T *x, *v;
  T *x_out, *v_out;
  Sheet sheet;
  int substeps;
  const double *handle_x, *handle_v;
  const T *body_x, *body_v;
  const double *body_x_end, *body_v_end, *wind;
  double pressure;
};

template <class T>
class Explicit {
 public:
  Explicit(Geometry<T> geometry, World world) : geometry_(std::move(geometry)), world_(std::move(world)) {}
  // Results do not depend on threads: a cloth is one thread's from start to end.
  void advance(const std::vector<Frame<T>>& frames, int threads) const;
  const Geometry<T>& geometry() const { return geometry_; }
  const World& world() const { return world_; }

 private:
  void advance(const Frame<T>& frame) const;
  Geometry<T> geometry_;
  World world_;
};

}  // namespace minicloth
