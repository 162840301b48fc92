// Particles on a grid, each joined to its neighbours by the cell of Zhao 2024 (eqs 6-7): frames for a batch.
#pragma once
#include <vector>

#include "../base/dispatch.hpp"
#include "../sheet/sheet.hpp"

namespace minicloth {

constexpr int kMostNeighbours = 16;

// A neighbour class: its offset on the grid and its coefficients [N/m], [N], [N s/m].
template <class T>
struct Link {
  int down, right;
  T alpha, beta, gamma;
};

// One step of a net of rows x cols particles, without contact and handles.
template <class T>
struct NetStep {
  int rows, cols, count;
  Link<T> links[kMostNeighbours];
  T bias[3], eps;
  T pressure;         // 0 where there is none
  T kick, decay, dt;  // h / m, exp(-drag h), h
};

// A ball during a step: inside it an inward velocity is removed, then the velocity shrinks to `keep` of itself.
template <class T>
struct NetBall {
  T centre[3], velocity[3], radius, keep;
};

// Planes (3, rows, cols). Writes the new velocities before the balls.
template <class T>
struct NetLanes {
  void (*velocities)(const NetStep<T>&, const T* x, const T* v, T* v_out);
  void (*ball)(const NetBall<T>&, int vertices, const T* x, T* v_out);
  void (*positions)(int numbers, T dt, const T* x, const T* v_out, T* x_out);
};
DECLARE_LANES(NetLanes<float>)
DECLARE_LANES(NetLanes<double>)

// What the whole batch shares; the bodies are balls, of the radii that they have.
template <class T>
struct Net {
  Sheet sheet;
  NetStep<T> step;  // its pressure is each cloth's own
  int substeps;
  double keep;
};

template <class T>
void advance(const Net<T>& net, const std::vector<Frame<T>>& frames, int threads);

}  // namespace minicloth
