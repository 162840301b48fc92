// What every solver is told of the cloths of a batch, and of one of them in a frame.
#pragma once
#include <vector>

namespace minicloth {

// A ball or capsule about an axis, or a plane through a point with a unit normal; these are each frame's own.
struct Body {
  bool plane;
  double radius, friction;  // m, Coulomb's coefficient
  int turns_with;           // the body with whose axis it turns about its own, -1 if it doesn't
};

// What all cloths of a batch share: the grid, which terms exist, what is driven.
struct Sheet {
  int rows, cols;
  double row_length, col_length;  // m, between vertices
  bool periodic;                  // a tube: the last column's neighbour is the first
  double frame_dt, gravity;       // s, m/s^2
  double thickness;               // m, added to the bodies' radii
  double self_thickness;          // m, between layers of the cloth; 0 where they pass through each other
  double self_friction;           // Coulomb's coefficient between layers
  bool air, pressure;
  double air_normal, air_lift, air_tangential;  // air density * coefficient [kg/m^3]
  std::vector<int> handles;                     // vertices
  std::vector<double> hold;  // 1/m^2 of each handle along x, y, z, infinite if it is firm: see drives.hpp
  std::vector<int> lead;     // the handle that each one moves with, itself where nothing else leads
  std::vector<Body> bodies;
};

// One cloth's material, as cloth_envs.material has it.
struct Material {
  double areal_density, stretch_stiffness, shear_stiffness, bend_stiffness;  // kg/m^2, N/m, N/m, N m
  double damping, drag;                                                      // s, 1/s
  double compression, buckling_strain, post_buckling, compression_damping, twist;
  bool yields() const { return compression != 1 || post_buckling != 1 || compression_damping != 1; }
  // Whether the explicit solver may have dashpots in the springs' lengths: see cloth_envs.material.
  bool simple() const { return !yields() && damping <= 2e-4; }
};

// One cloth's frame. Cloths (3, H, W), handles (N, 3), bodies (C, 2, 3); m, m/s, Pa.
template <class T>
struct Frame {
  const T *x, *v;
  T *x_out, *v_out;
  const T *body_x, *body_v;
  const double *handle_x, *handle_v, *body_x_end, *body_v_end, *wind;
  double pressure;
};

}  // namespace minicloth
