// Contact in P-ADMM: forces with Coulomb friction in the global step, and a last projection.
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "work.hpp"

namespace minicloth {
namespace {

template <class T>
Vec<T> pick(T* const (&planes)[3], int i) {
  return {planes[0][i], planes[1][i], planes[2][i]};
}
template <class T>
void place(T* const (&planes)[3], int i, const Vec<T>& v) {
  planes[0][i] = v.x, planes[1][i] = v.y, planes[2][i] = v.z;
}

// A vertex at a body: the outward normal, the distance from touching (negative inside), and how far the vertex slid
// along the body since the step began. `near` is false where the way can't have met the body.
template <class T>
struct Touch {
  bool near;
  Vec<T> normal;
  T gap;
  Vec<T> slip;
};

// The vertex goes from x0 to x1 while the body moves. Where the way enters a round body, the normal is the one at
// x1 if that is still on the same side, else the one where it came in: a fast body is not passed through.
// Vertices up to `margin` outside count as near.
template <class T>
Touch<T> touch(const BodyStep<T>& b, const Vec<T>& x0, const Vec<T>& x1, T margin = 0) {
  Touch<T> out = {true, {}, 0, {}};
  Vec<T> carried;
  if (b.plane) {
    out.normal = vec(b.after[1]);
    const Vec<T> point = vec(b.after[0]);
    out.gap = dot(out.normal, x1 - point) - b.radius;
    out.near = out.gap <= margin;
    carried = point - vec(b.before[0]);
  } else {
    const T t1 = nearest(b.after, x1);
    const Vec<T> c1 = axis_point(b.after, t1), p0 = x0 - axis_point(b.before, nearest(b.before, x0)), p1 = x1 - c1;
    const Vec<T> d = p1 - p0;
    const T square0 = dot(p0, p0), square1 = dot(p1, p1), way = dot(d, d), reach = b.radius + margin;
    const T outside = square0 - b.radius * b.radius, along = dot(p0, d), root = along * along - way * outside;
    const bool enters = outside >= 0 && along < 0 && root > 0 && (-along < way || square1 < b.radius * b.radius);
    if (!enters && outside >= 0 && square1 >= reach * reach) return {false, {}, 1, {}};
    const Vec<T> entry = enters ? p0 + (outside / (std::sqrt(root) - along)) * d : outside < 0 ? p0 : p1;
    const T size = std::sqrt(dot(entry, entry)), size1 = std::sqrt(square1);
    if (size == 0) return {false, {}, 1, {}};
    const bool same = dot(entry, p1) > T(0.5) * size * size1;
    out.normal = same ? (1 / size1) * p1 : (1 / size) * entry;
    out.gap = dot(out.normal, p1) - b.radius;
    carried = c1 - axis_point(b.before, t1) + b.radius * cross(vec(b.turn), out.normal);
  }
  const Vec<T> moved = x1 - x0 - carried;
  out.slip = moved - dot(moved, out.normal) * out.normal;
  return out;
}

// Share of the springs in the patch's stiffness. Measured: with settle() 0.1 to 1 do alike, 0 is much slower.
template <class T>
constexpr T kShare = T(0.1);

}  // namespace

template <class T>
void Admm<T>::approach(const std::vector<BodyStep<T>>& bodies, AdmmWork<T>& w) const {
  Patch<T>& c = w.contact;
  c.near.clear();
  if (bodies.empty()) return;
  c.kind.assign(geometry_.size, Patch<T>::kFree);
  for (auto* v : {&c.error, &c.normal, &c.slip, &c.force, &c.start}) v->resize(geometry_.size);
  c.friction.resize(geometry_.size);
  T way = 0;
  for (int i : free_) {
    const Vec<T> d = pick(w.goal, i) - pick(w.now.x, i);
    way = std::max(way, dot(d, d));
  }
  const T margin = std::sqrt(way) + 2 * geometry_.diagonal;
  for (int i : free_)
    for (const auto& body : bodies)
      if (touch(body, pick(w.now.x, i), pick(w.goal, i), margin).near) {
        c.near.push_back(i);
        break;
      }
}

// The force on a vertex in contact is f = -r - P e: r is the residual without contact, e the way from where the vertex
// should be, P the matrix of the step on the patch alone, with its border free. It moves the patch onto the bodies
// almost as the whole cloth's stiffness lets it; a stiffness of the vertices alone (Ly et al. 2020) is much slower.
// f is then cut back to Coulomb's cone; vertices that slide feel only their own inertia along the body. At a fixed
// point r + f = 0, so gaps and forces obey Signorini and Coulomb.
template <class T>
void Admm<T>::push(const std::vector<BodyStep<T>>& bodies, const LocalTerms<T>& terms, AdmmWork<T>& w) const {
  const Geometry<T>& g = geometry_;
  Patch<T>& c = w.contact;
  using Kind = typename Patch<T>::Kind;
  c.active.clear();
  for (int i : c.near) {
    const bool held = c.kind[i] != Patch<T>::kFree;
    Touch<T> most = {false, {}, 0, {}};
    for (const auto& body : bodies) {
      const Touch<T> t = touch(body, pick(w.now.x, i), pick(w.x, i), held ? std::numeric_limits<T>::max() : T(0));
      if (t.near && (!most.near || t.gap < most.gap)) most = t, c.friction[i] = body.friction;
    }
    if (!most.near || (most.gap >= 0 && !held)) {
      c.kind[i] = Patch<T>::kFree;
      continue;
    }
    if (!held) c.kind[i] = Patch<T>::kStick;
    c.normal[i] = most.normal, c.slip[i] = most.slip;
    c.error[i] = most.gap * most.normal;
    if (c.kind[i] == Patch<T>::kStick) c.error[i] = c.error[i] + most.slip;
    c.active.push_back(i);
  }
  const int s = g.stride;
  std::vector<std::pair<Vec<T>, Kind>> next;
  next.reserve(c.active.size());
  for (int i : c.active) {
    const T inertia = terms.inertia * area_[i];
    Vec<T> push = inertia * c.error[i];
    const int col = g.periodic ? (i - g.origin) % s : -1;
    const auto edge = [&](int down, int right, T k) {
      if (k == 0) return;
      int j = i + down * s + right;
      if (g.periodic) j += col + right < 0 ? g.cols : col + right >= g.cols ? -g.cols : 0;  // round a tube
      if (c.kind[j] != Patch<T>::kFree) push = push + kShare<T> * k * (c.error[i] - c.error[j]);
    };
    edge(0, 1, terms.stretch * g.along[i]), edge(0, -1, terms.stretch * g.along[i - 1]);
    edge(1, 0, terms.stretch * g.down[i]), edge(-1, 0, terms.stretch * g.down[i - s]);
    edge(1, 1, terms.shear * g.right[i]), edge(-1, -1, terms.shear * g.right[i - s - 1]);
    edge(1, -1, terms.shear * g.left[i]), edge(-1, 1, terms.shear * g.left[i - s + 1]);
    if (c.kind[i] == Patch<T>::kSlide) push = push + inertia * c.slip[i];
    const Vec<T> force = T(-1) * (pick(w.residual, i) + push);
    const T pressing = dot(force, c.normal[i]), most = c.friction[i] * pressing;
    const Vec<T> along = force - pressing * c.normal[i];
    const T size = std::sqrt(dot(along, along));
    if (pressing <= 0)
      next.push_back({{0, 0, 0}, Patch<T>::kFree});
    else if (size <= most)
      next.push_back({force, Patch<T>::kStick});
    else
      next.push_back({pressing * c.normal[i] + (most / size) * along, Patch<T>::kSlide});
  }
  for (std::size_t a = 0; a < next.size(); ++a) {
    const int i = c.active[a];
    c.force[i] = next[a].first, c.kind[i] = next[a].second, c.start[i] = pick(w.x, i);
  }
}

template <class T>
void Admm<T>::project(const std::vector<BodyStep<T>>& bodies, AdmmWork<T>& w) const {
  for (const auto& body : bodies)
    for (int i : free_) {
      const Vec<T> x = pick(w.x, i);
      const Touch<T> t = touch(body, pick(w.now.x, i), x);
      if (!t.near || t.gap >= 0) continue;
      const T size = std::sqrt(dot(t.slip, t.slip)), most = -body.friction * t.gap;
      place(w.x, i, x - t.gap * t.normal - (size > most ? most / size : T(1)) * t.slip);
    }
}

// The forces move x by A^-1 f, times the share for which they close the gaps on average over the forces: a step of
// steepest descent of the dual problem. Without it a fast body throws the cloth away.
template <class T>
void Admm<T>::settle(const System<T>& system, AdmmWork<T>& w) const {
  Patch<T>& c = w.contact;
  for (int k = 0; k < 3; ++k) {
    std::fill_n(w.residual[k], geometry_.size, T(0));
    std::fill_n(w.shift[k], geometry_.size, T(0));
  }
  for (int i : c.active) place(w.residual, i, c.force[i]);
  correct(system, w, w.shift);
  double missing = 0, gain = 0;
  for (int i : c.active) {
    if (c.kind[i] == Patch<T>::kFree) continue;
    const Vec<T> along = c.kind[i] == Patch<T>::kStick ? c.force[i] : dot(c.force[i], c.normal[i]) * c.normal[i];
    missing -= dot(along, pick(w.x, i) - c.start[i] + c.error[i]);
    gain += dot(along, pick(w.shift, i));
  }
  const T scale = gain > 0 ? T(std::min(std::max(missing / gain, 0.0), 1.0)) : T(1);
  for (int k = 0; k < 3; ++k)
    for (std::size_t i = 0; i < geometry_.size; ++i) w.x[k][i] += scale * w.shift[k][i];
}

#define INSTANTIATE(T)                                                                                    \
  template void Admm<T>::settle(const System<T>&, AdmmWork<T>&) const;                                    \
  template void Admm<T>::approach(const std::vector<BodyStep<T>>&, AdmmWork<T>&) const;                   \
  template void Admm<T>::push(const std::vector<BodyStep<T>>&, const LocalTerms<T>&, AdmmWork<T>&) const; \
  template void Admm<T>::project(const std::vector<BodyStep<T>>&, AdmmWork<T>&) const;
INSTANTIATE(float)
INSTANTIATE(double)

}  // namespace minicloth
