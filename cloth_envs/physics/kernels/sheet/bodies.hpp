// The geometry of bodies; contact.hpp has it in vectors.
#pragma once
#include "../base/vec.hpp"

namespace minicloth {

// A body over one step: two end points of its axis before and after, or of a plane a point [0] and the unit normal [1].
template <class T>
struct BodyStep {
  bool plane;
  T before[2][3], after[2][3];
  T radius, friction, dt;  // radius includes the thickness
  T turn[3];               // by which it turns about its axis, along that [rad]
};

// The same of one body in every lane of vectors: of several cloths, or of one.
enum class Shape { kSphere, kCapsule, kPlane };
template <class T>
constexpr int kMostLanes = 64 / int(sizeof(T));  // of any instruction set
template <class T, int width = kMostLanes<T>>
struct BodyLanes {
  Shape shape;
  T radius, friction;
  alignas(width * sizeof(T)) T before[2][3][width];
  T after[2][3][width];
  T turn[3][width];
  // For some steps: the box of where the axis will be, and how far it goes along x, y or z at most.
  T low[3][width], high[3][width], way[width];
};

constexpr double kTurnLeast = 0.1;  // of the squared length of what turns with it, the least of its part across
constexpr double kDeep = 1e-5;      // m, from which on a vertex is inside one of several bodies
constexpr int kSweeps = 8;          // at most, over all bodies, until it is in none

// How far along a body's axis, from 0 to 1, the point nearest to q lies; and that point.
template <class T>
T nearest(const T (&ends)[2][3], const Vec<T>& q) {
  const Vec<T> axis = vec(ends[1]) - vec(ends[0]);
  const T square = dot(axis, axis);
  if (square == 0) return 0;
  const T t = dot(q - vec(ends[0]), axis) / square;
  return t < 0 ? T(0) : t > 1 ? T(1) : t;
}
template <class T>
Vec<T> axis_point(const T (&ends)[2][3], T t) {
  return vec(ends[0]) + t * (vec(ends[1]) - vec(ends[0]));
}

}  // namespace minicloth
