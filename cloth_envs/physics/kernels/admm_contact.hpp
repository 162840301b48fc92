// Contact in the global step: Coulomb friction as a force at each vertex that stops it on the body.
#pragma once
#include <cmath>
#include <vector>

#include "admm.hpp"

namespace minicloth {

template <class T>
struct Vec {
  T x, y, z;
};
template <class T>
Vec<T> operator+(const Vec<T>& a, const Vec<T>& b) {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
template <class T>
Vec<T> operator-(const Vec<T>& a, const Vec<T>& b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
template <class T>
Vec<T> operator*(T s, const Vec<T>& a) {
  return {s * a.x, s * a.y, s * a.z};
}
template <class T>
T dot(const Vec<T>& a, const Vec<T>& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
template <class T>
Vec<T> pick(T* const (&planes)[3], int i) {
  return {planes[0][i], planes[1][i], planes[2][i]};
}
template <class T>
void place(T* const (&planes)[3], int i, const Vec<T>& v) {
  planes[0][i] = v.x, planes[1][i] = v.y, planes[2][i] = v.z;
}

// A vertex at a body: the outward normal, the distance from touching (negative inside), and how far the vertex slid
// along the body since the step began. `near` is false where the body can't matter.
template <class T>
struct Touch {
  bool near;
  Vec<T> normal;
  T gap;
  Vec<T> slip;
};

template <class T>
Vec<T> axis_point(const T (&ends)[2][3], T t) {
  return {ends[0][0] + t * (ends[1][0] - ends[0][0]), ends[0][1] + t * (ends[1][1] - ends[0][1]),
          ends[0][2] + t * (ends[1][2] - ends[0][2])};
}
template <class T>
T nearest(const T (&ends)[2][3], const Vec<T>& q) {
  const Vec<T> a = {ends[1][0] - ends[0][0], ends[1][1] - ends[0][1], ends[1][2] - ends[0][2]};
  const T square = dot(a, a);
  if (square == 0) return 0;
  const T t = dot(q - Vec<T>{ends[0][0], ends[0][1], ends[0][2]}, a) / square;
  return t < 0 ? T(0) : t > 1 ? T(1) : t;
}

// The vertex goes from x0 to x1 while the body moves. Where the way enters a round body, the normal is the one at
// x1 if that is still on the same side, else the one where it came in: a fast body is not passed through.
template <class T>
Touch<T> touch(const BodyStep<T>& b, const Vec<T>& x0, const Vec<T>& x1) {
  Touch<T> out = {true, {}, 0, {}};
  Vec<T> carried;
  if (b.plane) {
    out.normal = {b.after[1][0], b.after[1][1], b.after[1][2]};
    const Vec<T> point = {b.after[0][0], b.after[0][1], b.after[0][2]};
    out.gap = dot(out.normal, x1 - point) - b.radius;
    carried = point - Vec<T>{b.before[0][0], b.before[0][1], b.before[0][2]};
  } else {
    const T t1 = nearest(b.after, x1);
    const Vec<T> c1 = axis_point(b.after, t1), p0 = x0 - axis_point(b.before, nearest(b.before, x0)), p1 = x1 - c1;
    const Vec<T> d = p1 - p0;
    const T square0 = dot(p0, p0), square1 = dot(p1, p1), way = dot(d, d), reach = b.radius + std::sqrt(way);
    if (square1 > reach * reach) return {false, {}, 1, {}};
    const T outside = square0 - b.radius * b.radius, along = dot(p0, d), root = along * along - way * outside;
    Vec<T> entry = p1;
    if (outside < 0) {
      entry = p0;
    } else if (along < 0 && root > 0) {
      const T first = outside / (std::sqrt(root) - along);
      if (first <= 1) entry = p0 + first * d;
    }
    const T size = std::sqrt(dot(entry, entry)), size1 = std::sqrt(square1);
    if (size == 0) return {false, {}, 1, {}};
    const bool same = dot(entry, p1) > T(0.5) * size * size1;
    out.normal = same ? (1 / size1) * p1 : (1 / size) * entry;
    out.gap = dot(out.normal, p1) - b.radius;
    carried = c1 - axis_point(b.before, t1);
  }
  const Vec<T> moved = x1 - x0 - carried;
  out.slip = moved - dot(moved, out.normal) * out.normal;
  return out;
}

// Vertices in contact. The force on them is what moves the patch onto the bodies by the patch's own stiffness:
// f = -P e - r with e the way from where each should be, r the residual without contact, P the global matrix
// restricted to the patch as if its border were free. P is at most the true Schur complement, so the iteration is
// stable; it is exact for a patch that moves as one. Then f is cut back to Coulomb's cone; vertices that slide feel
// only their own inertia along the body. At a fixed point r + f = 0, so gap and force obey Signorini and Coulomb
// exactly.
template <class T>
struct Patch {
  enum Kind : char { kFree, kStick, kSlide };
  std::vector<Kind> kind;                   // of every vertex, padded as Geometry says
  std::vector<int> active;                  // vertices in contact now
  std::vector<Vec<T>> error, normal, slip;  // as kind
  std::vector<T> friction;

  void begin(std::size_t size) {
    if (kind.size() != size) {
      kind.assign(size, kFree), error.assign(size, {}), normal.assign(size, {}), slip.assign(size, {});
      friction.assign(size, T(0));
    }
    for (int i : active) kind[i] = kFree;
    active.clear();
  }
};

}  // namespace minicloth
