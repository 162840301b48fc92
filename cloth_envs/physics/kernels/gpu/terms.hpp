// What a graphics card is told of a batch: plain structures, laid out alike in C++, in CUDA and in NumPy
// (gpu/terms.py).
#pragma once
#include "../sheet/cubic.hpp"

namespace minicloth {

constexpr int kLevels = 3;

// What all cloths share; Sheet of sheet.hpp with what the step bound counts on.
struct CardSheet {
  int rows, cols, periodic, handles, soft, bodies, air, pressure, bends;
  int spare;  // whether held forces wait in x_out, for want of shared memory
  double row_length, col_length, diagonal, frame_dt, gravity;
  double air_normal, air_lift, air_tangential;  // air density * coefficient [kg/m^3]
  double fastest, max_wind, usual_pressure;     // m/s, m/s, Pa: what steps are short enough for
  double sheared, most_sheared;                 // sines of shear up to which the first two ways to cut a frame hold
};

struct CardBody {
  double radius, friction;  // m, with the thickness; Coulomb's coefficient
  int plane;
};

// One cloth's material as it is stepped, and how its frames are cut.
struct CardCloth {
  float stretch, shear, damping, bend, twist, yields, buckled, buckling, shortened_damping;  // as StepTerms
  float density, drag;
  float parting;  // m/s, of neighbours: above it frames are cut as by the last level
  float air;      // 1/m: the air's rate over the velocity
  float push;     // 1/(s^2 Pa): what a pressure adds to the stiffness over the mass
  int simple;
  int cuts[kLevels][2];  // substeps, and for how many of them slow forces are held
};

// A batch. Cloths (B, 3, H, W), handles (B, N, 3), bodies (B, C, 2, 3); m, m/s, Pa.
struct CardBatch {
  const CardCloth* cloths;
  const CardBody* bodies;
  const float *x, *v;
  float *x_out, *v_out;
  const float *body_x, *body_v;
  const double *body_x_end, *body_v_end, *handle_x, *handle_v, *wind, *pressure;
  const int *handle_of, *handles, *lead;  // of each vertex its handle or -1; the handles' vertices; what leads each
  const double* hold;                     // 1/m^2 of each handle along x, y, z, infinite if it is firm
  float* health;                          // (B, 3): all finite, largest structural strain, kinetic energy [J/kg]
  int* taken;  // (B, 2): the substeps of the frame, and of how many the slow forces were held
};

}  // namespace minicloth
