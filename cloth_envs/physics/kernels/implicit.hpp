// The incremental potential of one stage of an implicit step, and contact as constraints on it. All in double.
#pragma once
#include <nanobind/nanobind.h>

#include <vector>

#include "explicit.hpp"

namespace minicloth {

// What a stage of length tau holds fixed. Arrays (3, H, W).
struct Stage {
  Sheet sheet;
  double tau;           // s; velocities are (x - base) / tau
  double inertia;       // 1/s^2: the potential has density * area * inertia |x - target|^2 / 2
  const double* base;   // m
  const double* along;  // m, where dashpots and the air take directions and areas from
  double* target;       // m; the air's pressure is added to it here
  double wind_normal, wind_tangential, wind[3], pressure;  // as in World; Pa
};

// Phi(x) = inertia + springs with dashpots + bending + wind; springs and dashpots are one spring of stiffness
// k' = k (1 + damping / tau) and length L' = (L + damping / tau * l) / (1 + damping / tau), l = d_base along d.
class Potential {
 public:
  Potential(int rows, int cols, double row_length, double col_length, bool periodic);
  void begin(const Stage& stage);
  double evaluate(const double* x, double* gradient);  // (3, H, W); J, N
  int vertices() const { return geometry_.rows * geometry_.cols; }
  int rows() const { return geometry_.rows; }
  int cols() const { return geometry_.cols; }

 private:
  struct Springs {
    int offset;
    double length;
    const Plane<double>*weight, *linear;  // of the geometry; linear: bending on the same edges
    Plane<double> stiffness, rest, bend;
  };
  struct Far {
    int offset;
    const Plane<double>* weight;
    Plane<double> bend;
  };
  void pad(const double* from, Plane<double>& to) const;
  void fold();
  Geometry<double> geometry_;
  std::vector<Springs> springs_;
  std::vector<Far> far_;
  Plane<double> x_, g_, base_, along_, v_;  // 3 * size, padded as Geometry says
  Plane<double> air_;                       // 16 * size: unit normal and area / 4 of the four facets of each cell
  std::vector<double> mass_, target_;
  bool wind_ = false;
  double tau_ = 1, normal_ = 0, tangential_ = 0, wind_velocity_[3] = {};
};

// Vertices against bodies with Coulomb friction: what holds a vertex, and what it may not do.
class Contact {
 public:
  enum Hold : signed char { kFree, kSlides, kSticks };
  // slack: how near to a body [m] a vertex counts as touching it.
  Contact(int vertices, std::vector<int> handles, std::vector<Body> bodies, double thickness, double slack);
  // Vertices (3, n) and bodies (C, 2, 3) at the start of the step and as the stage's base, bodies at its end.
  void begin(const double* start, const double* base, const double* bodies_start, const double* bodies_base,
             const double* bodies_end, double tau);
  // Moves x (3, n) out of the bodies; vertices held in the last feasible place `from` stay on their body.
  void project(const double* from, double* x) const;
  // From the gradient g of the potential at x: what holds each vertex, with which load [N]; and the part of
  // g, with friction, that the vertex is free to follow. Returns the largest of it over a vertex's mass.
  double classify(const double* x, const double* g, const double* mass, double* free_gradient);
  // Energy sum mu N |slip| of friction under the loads of classify; its gradient is added to g.
  double friction(const double* x, double* g) const;
  void confine(const double* x, double* d) const;  // removes from a direction at x what is held
  // Velocities (3, n) of held vertices become those of their body; reaction (3, n) [N] of all that is held.
  void finish(const double* x, const double* g, const double* free_gradient, double* v, double* reaction) const;
  int vertices() const { return n_; }
  int bodies() const { return int(bodies_.size()); }

 private:
  struct Ends {
    double p[2][3];
  };
  struct Hit {
    double normal[3], gap, s;
  };
  Hit nearest(int body, const double* x) const;
  void anchor(int vertex, int body, double s, double* out) const;
  void place(int body, double* x) const;
  bool enters(int body, int vertex, double* x) const;
  void slip(int vertex, int body, const Hit& hit, const double* x, double* out) const;
  int n_;
  double slack_, tau_ = 1;
  std::vector<Body> bodies_;
  std::vector<Ends> start_, base_, end_;
  std::vector<double> x_start_, x_base_, load_;
  std::vector<signed char> hold_;
  std::vector<int> body_;  // -1 for handles and free vertices
};

void bind_implicit(nanobind::module_& m);

}  // namespace minicloth
