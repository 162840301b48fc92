// The incremental potential of one stage of an implicit step. All in double.
#pragma once
#include <vector>

#include "../base/dispatch.hpp"
#include "../base/geometry.hpp"
#include "../sheet/sheet.hpp"

namespace minicloth {

// What a stage of length tau holds fixed. Arrays (3, H, W).
struct Stage {
  Material material;
  double tau;                // s; velocities are (x - base) / tau
  double inertia;            // 1/s^2: the potential has density * area * inertia |x - target|^2 / 2
  const double* base;        // m
  const double* along;       // m, where dashpots and the air take directions and areas from
  double* target;            // m; the air's pressure is added to it here
  const double* velocity;    // m/s, where the air takes the sliding speed of its lift from
  double wind[3], pressure;  // m/s, Pa
};

// The loops over padded planes, `size` apart. Each adds a gradient to g and returns an energy.
struct ImplicitLanes {
  // Springs from i to i + offset: k (|d| - L)^2 / 2 + b |d|^2 / 2.
  double (*springs)(const double* x, double* g, std::size_t size, int begin, int end, int offset, const double* k,
                    const double* rest, const double* bend);
  // b |x_j - x_i|^2 / 2, with j = i + offset.
  double (*linear)(const double* x, double* g, std::size_t size, int begin, int end, int offset, const double* bend);
  // The air on cells: see air_energy in sheet/air.hpp.
  double (*air)(const double* v, double* g, std::size_t size, int begin, int end, int stride, const double* air,
                double normal, double tangential, double w0, double w1, double w2);
};
DECLARE_LANES(ImplicitLanes)

// Phi(x) = inertia + springs with dashpots + bending + air; springs and dashpots are one spring of stiffness
// k' = k (1 + damping / tau) and length L' = (L + damping / tau * l) / (1 + damping / tau), l = d_base along d.
class Potential {
 public:
  explicit Potential(Sheet sheet);
  void begin(const Stage& stage);
  // Until the next begin, springs of a stiffness [N/m] draw some of the 3 n coordinates to places.
  void draw(const int* which, const double* stiffness, const double* places, int count);
  double evaluate(const double* x, double* gradient);  // (3, H, W); J, N
  int vertices() const { return geometry_.vertices(); }

 private:
  struct Springs {
    int offset;
    double length;
    const Plane<double>*weight, *linear;  // of the geometry; linear: bending on the same edges, if there is any
    double twist;                         // times the weight, of bending too
    Plane<double> stiffness, rest, bend;
  };
  struct Far {
    int offset;
    const Plane<double>* weight;
    Plane<double> bend;
  };
  void pad(const double* from, Plane<double>& to) const;
  void fold();
  Sheet sheet_;
  Geometry<double> geometry_;
  std::vector<Springs> springs_;
  std::vector<Far> far_;
  Plane<double> x_, g_, base_, along_, v_;  // 3 * size, padded as Geometry says
  Plane<double> air_;                       // 6 * size: what air_energy needs of each cell
  std::vector<double> mass_, target_;
  struct Pull {
    int at;
    double stiffness, place;
  };
  std::vector<Pull> pulls_;
  double tau_ = 1, wind_velocity_[3] = {};
};

}  // namespace minicloth
