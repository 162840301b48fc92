// Particles on a grid, each joined to its neighbours by the cell of Zhao 2024 (eqs 6-7): frames for a batch.
#pragma once
#include <algorithm>
#include <cstdlib>
#include <vector>

#include "../base/dispatch.hpp"
#include "../sheet/sheet.hpp"

namespace minicloth {

constexpr int kMostNeighbours = 16;

// Where particles lie: side by side, by row, in waves of one number c + 2 r. Of all neighbours those that come before a
// particle, row by row, lie in earlier waves and those after it in later ones, so a wave is one vector loop even where
// particles see the new velocities of those before them. What else lies in a wave are ghosts, finite and of no effect.
struct Waves {
  static constexpr int kGhosts = 16;  // no vector is longer
  int rows, cols;
  int stride() const { return (rows + kGhosts + 15) / 16 * 16; }
  int count() const { return cols + 2 * (rows - 1); }
  int size() const { return (count() + 2 * kMargin) * stride(); }
  int at(int row, int col) const { return (kMargin + col + 2 * row) * stride() + row; }
  int shift(int down, int right) const { return at(down, right) - at(0, 0); }
  // The rows first .. last - 1 of a wave that have a neighbour there, themselves at (0, 0).
  struct Range {
    int first, last;
  };
  Range with(int wave, int down, int right) const {
    const int a = std::max(0, right), b = std::min(0, right);  // columns -b .. cols - 1 - a have one
    return {std::max(std::max(0, -down), (wave + a - cols + 2) >> 1),
            std::min(rows - std::max(0, down), ((wave + b) >> 1) + 1)};
  }

  // Whether a neighbour lies in the margin, and in an earlier wave if it comes before, in a later one if after.
  static bool reached(int down, int right) {
    const int waves = right + 2 * down;
    return std::abs(waves) < kMargin && (down ? down * waves > 0 : right != 0);
  }

 private:
  static constexpr int kMargin = 8;  // waves before the first and after the last
};

// A neighbour class: its offset on the grid and in waves, and its coefficients [N/m], [N], [N s/m].
template <class T>
struct Link {
  int down, right, shift;
  T alpha, beta, gamma;
};

// One step of a net of particles, without contact and handles.
template <class T>
struct NetStep {
  Waves waves;
  int count;
  Link<T> links[kMostNeighbours];
  T weight[3], eps;   // what a step of the bias adds to a velocity [m/s]
  T pressure;         // 0 where there is none
  T kick, decay, dt;  // h / m, exp(-drag h), h
};

// A ball during a step: inside it an inward velocity is removed, then the velocity shrinks to `keep` of itself.
template <class T>
struct NetBall {
  T centre[3], velocity[3], radius, keep;
};

// Three planes in waves.
template <class T>
using Axes = T* const (&)[3];

template <class T>
struct NetLanes {
  // All velocities get the weight in place, then, in `out`, what a step of the forces gives. Where `out` is `v`, each
  // particle feels the new velocities of those before it, row by row.
  void (*velocities)(const NetStep<T>&, Axes<T> x, Axes<T> v, Axes<T> out);
  // Drag, balls, then x += h v.
  void (*move)(const NetStep<T>&, const std::vector<NetBall<T>>&, Axes<T> x, Axes<T> v);
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
  bool in_place;  // whether a particle feels the new velocities of those before it
};

template <class T>
void advance(const Net<T>& net, const std::vector<Frame<T>>& frames, int threads);

}  // namespace minicloth
