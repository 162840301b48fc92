// The geometry of bodies; contact.hpp has it in vectors.
#pragma once
#include <algorithm>

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
template <class T>
struct BodyLanes {
  Shape shape;
  T radius, friction;
  alignas(64) T before[2][3][kMostLanes<T>];
  T after[2][3][kMostLanes<T>];
  T turn[3][kMostLanes<T>];
  // For some steps: the box of where the axis will be, and how far it goes along x, y or z at most.
  T low[3][kMostLanes<T>], high[3][kMostLanes<T>], way[kMostLanes<T>];
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

// By how much a capsule turns about its axis, along that [rad], as the part across of an axis that goes from o0 to o1
// does while its own goes from a0 to a1. Less where the two are nearly parallel.
inline Vec<double> turned(const double (&a0)[2][3], const double (&a1)[2][3], const double (&o0)[2][3],
                          const double (&o1)[2][3]) {
  const Vec<double> from = vec(a0[1]) - vec(a0[0]), to = vec(a1[1]) - vec(a1[0]);
  const double from2 = dot(from, from), to2 = dot(to, to);
  if (from2 == 0 || to2 == 0) return {};
  const Vec<double> was = vec(o0[1]) - vec(o0[0]), is = vec(o1[1]) - vec(o1[0]);
  const Vec<double> across0 = was - (dot(was, from) / from2) * from, across1 = is - (dot(is, to) / to2) * to;
  const double least = kTurnLeast * dot(is, is), square = dot(across1, across1);
  return dot(to, cross(across0, across1)) / (to2 * std::max({square, least, 1e-300})) * to;
}

}  // namespace minicloth
