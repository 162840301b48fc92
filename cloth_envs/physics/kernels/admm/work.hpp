// What one thread needs for P-ADMM.
#pragma once
#include <vector>

#include "../base/vec.hpp"
#include "core.hpp"

namespace minicloth {

// Vertices in contact, and those that may come into contact during a step. Places as in Geometry.
template <class T>
struct Patch {
  enum Kind : char { kFree, kStick, kSlide };
  std::vector<Kind> kind;         // of every vertex, as all below
  std::vector<int> near, active;  // vertices
  std::vector<Vec<T>> error;      // the way from where it should be [m]
  std::vector<Vec<T>> normal, slip, force, start;
  std::vector<T> friction;
};

template <class T>
struct AdmmWork {
  long owner = -1;
  Plane<T> memory;
  Planes<T> now;  // at the step's start
  T *x[3], *goal[3], *residual[3], *shift[3], *rest[4], *tail[9];
  EdgePlanes<T> u;
  Cells<T> air;
  // Transforms: half rows (3 H, W); modes and half columns (H, width); places along a row (H, padded halves).
  Plane<T> folded, first, second, third, places;
  Plane<T> held_lines, held, pull;  // (held rows, width), (3, padded p) twice
  Patch<T> contact;
};

}  // namespace minicloth
