// Particles on a grid, each joined to its neighbours by the cell of Zhao 2024 (eqs 6-7): frames for a batch.
#pragma once
#include <vector>

namespace nanobind {
class module_;
}

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
template <class T>
const NetLanes<T>& best_net_lanes();

// What the whole batch shares.
template <class T>
struct Net {
  NetStep<T> step;  // its pressure is each cloth's own
  double frame_dt;
  int substeps;
  double keep;
  std::vector<int> handles;   // vertex numbers
  std::vector<double> radii;  // of the balls [m]
};

// One cloth's frame. Arrays (3, H, W), (N, 3) and (C, 2, 3).
template <class T>
struct NetFrame {
  const T *x, *v;
  T *x_out, *v_out;
  const double *handle_x, *handle_v;
  const T *body_x, *body_v;
  const double *body_x_end, *body_v_end;
  double pressure;
};

template <class T>
void advance(const Net<T>& net, const std::vector<NetFrame<T>>& frames, int threads);

void bind_particles(nanobind::module_& m);

}  // namespace minicloth
