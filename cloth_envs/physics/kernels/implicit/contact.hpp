// Contact as constraints on the potential of an implicit step. All in double.
#pragma once
#include <vector>

#include "../base/vec.hpp"
#include "../sheet/sheet.hpp"

namespace minicloth {

// Vertices against bodies with Coulomb friction: what holds a vertex, and what it may not do.
class Contact {
 public:
  enum Hold : signed char { kFree, kSlides, kSticks };
  // slack: how near to a body [m] a vertex counts as touching it.
  Contact(const Sheet& sheet, double slack);
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
  using Point = Vec<double>;
  struct Hit {
    Point normal;
    double gap, s;
  };
  Point at(const double* x, int vertex) const;
  void put(double* x, int vertex, const Point& p) const;
  Hit hit(int body, const Point& x) const;
  Point anchor(int vertex, int body, double s) const;
  Point placed(int body, const Point& x) const;
  bool enters(int body, int vertex, Point& x) const;
  Point slip(int vertex, int body, const Hit& hit, const Point& x) const;
  int n_;
  double slack_, tau_ = 1;
  std::vector<Body> bodies_;
  std::vector<Point> turn_;  // of each from base to end, along its axis [rad]
  std::vector<Ends> start_, base_, end_;
  std::vector<double> x_start_, x_base_, load_;
  std::vector<signed char> hold_;
  std::vector<int> body_;  // -1 for firm handles and free vertices
};

}  // namespace minicloth
