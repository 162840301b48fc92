// The hot loops. lanes.cpp is compiled once for each instruction set; the best one is chosen at run time.
#pragma once
#include "geometry.hpp"

namespace minicloth {

template <class T>
struct Planes {  // positions and velocities, padded as Geometry says
  T *x[3], *v[3];
};

template <class T>
struct Cells {  // the air's force on the four corners of the cell at its upper left vertex [N]
  T* corner[4][3];
};

// Forces of the edges that leave every vertex towards row + 1 and both diagonals, and (in narrow grids) the sum of
// what a vertex feels without those that arrive from the row above; 0 before Geometry::begin.
template <class T>
struct Edges {
  T *sum[3], *down[3], *right[3], *left[3];
  int ring;  // an element's place is its number modulo this; the first block is repeated after the last
};

template <class T>
struct StepTerms {
  T stretch, shear, bend, damping;        // N/m, N/m, N m, s
  T yields, buckled, buckling;            // of a shortened spring: see explicit.cpp
  T shortened_damping;                    // s
  T accelerate, decay, dt, gravity_kick;  // force/area -> dv, v factor, s, dv of gravity
};

template <class T>
struct AirTerms {
  T normal, tangential, pressure;  // density * coefficient / 4 [kg/m^3], Pa
  T wind[3];                       // m/s
};

template <class T>
struct BodyStep {  // a body over one substep: two end points of its axis before and after
  bool plane;      // before/after[0] is a point, [1] the unit normal
  T before[2][3], after[2][3];
  T radius, friction, dt;  // radius includes the thickness
};

struct Check {
  bool finite;
  double strain;   // of the longest structural edge
  double kinetic;  // energy per mass [J/kg], vertices weighted alike
};

template <class T>
struct Lanes {
  // One substep of springs, dampers, bending, gravity, drag and the listed forces of the air.
  using Step = void (*)(const Geometry<T>&, const StepTerms<T>&, const Planes<T>& in, const Planes<T>& out,
                        const Cells<T>& air, const Edges<T>& edges);
  Step step[2][2][2];     // [damping][bending][air]
  Step yielding_step[2];  // [air]; springs that yield under compression, with damping and bending, which may be 0
  using Air = void (*)(const Geometry<T>&, const AirTerms<T>&, const Planes<T>& in, const Cells<T>& out);
  Air air[2];  // [wind]; pressure alone needs no velocities
  void (*contact)(const Geometry<T>&, const BodyStep<T>&, const Planes<T>& in, const Planes<T>& out);
  Check (*check)(const T* x, const T* v, int rows, int cols, T row_length, T col_length, bool periodic);
};

template <class T>
const Lanes<T>& best_lanes();
const char* best_lanes_name();

}  // namespace minicloth
