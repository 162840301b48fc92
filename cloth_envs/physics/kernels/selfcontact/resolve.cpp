// How a vertex and a triangle, or two edges, are kept apart.
#include <algorithm>
#include <cmath>
#include <utility>

#include "../base/vec.hpp"
#include "core.hpp"

namespace minicloth {
namespace {

constexpr double kRelax = 0.001;  // s, in which layers that are too near go apart,
constexpr double kCreep = 1;      // m/s, at most, over how many pairs a vertex is in: springs feel what is moved
constexpr int kPasses = 4;        // over what is kept apart, while some of it is very near

// Shares in their distance: 1 of a vertex, and those of the point of a triangle that is nearest to it (Ericson 2005,
// section 5.1.5).
template <class T>
void nearest_in_triangle(const Vec<T> (&x)[4], T (&share)[4]) {
  const Vec<T>&p = x[0], &a = x[1], &b = x[2], &c = x[3], ab = b - a, ac = c - a;
  const T d1 = dot(ab, p - a), d2 = dot(ac, p - a), d3 = dot(ab, p - b), d4 = dot(ac, p - b), d5 = dot(ab, p - c),
          d6 = dot(ac, p - c), va = d3 * d6 - d5 * d4, vb = d5 * d2 - d1 * d6, vc = d1 * d4 - d3 * d2;
  const auto at = [&](T v, T w) { share[0] = 1, share[1] = v + w - 1, share[2] = -v, share[3] = -w; };
  if (d1 <= 0 && d2 <= 0) return at(0, 0);
  if (d3 >= 0 && d4 <= d3) return at(1, 0);
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return at(d1 / (d1 - d3), 0);
  if (d6 >= 0 && d5 <= d6) return at(0, 1);
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return at(0, d2 / (d2 - d6));
  if (va <= 0 && d4 >= d3 && d5 >= d6) {
    const T w = (d4 - d3) / ((d4 - d3) + (d5 - d6));
    return at(1 - w, w);
  }
  return at(vb / (va + vb + vc), vc / (va + vb + vc));
}

// The same of the ends of two edges (section 5.1.9).
template <class T>
void nearest_on_edges(const Vec<T> (&x)[4], T (&share)[4]) {
  const auto inside = [](T t) { return std::min(std::max(t, T(0)), T(1)); };
  const Vec<T> d = x[1] - x[0], e = x[3] - x[2], r = x[0] - x[2];
  const T a = dot(d, d), b = dot(d, e), c = dot(d, r), g = dot(e, e), f = dot(e, r), area = a * g - b * b;
  T s = area > T(1e-6) * a * g ? inside((b * f - c * g) / area) : T(0);
  const T t = inside((b * s + f) / g);
  s = inside((b * t - c) / a);
  share[0] = 1 - s, share[1] = s, share[2] = t - 1, share[3] = -t;
}

}  // namespace

// Looks at what is due now, keeps apart what has to be, and says when to look again.
template <class T>
void SelfContact<T>::look(bool edges, std::vector<int>& which) {
  const int count = int(which.size());
  if (!count) return;
  wait_.resize(count), acts_.clear();
  lanes<NearLanes<T>>().look(f_.x, f_.v, strips_->width, sweep_, parts_.data(), which.data(), count, edges,
                             {layer_, layer_ / 2, h_}, wait_.data());
  for (int i = 0; i < count; ++i) {
    const int steps = wait_[i] & (kAct - 1);
    if (wait_[i] & kAct) {
      acts_.push_back({which[i], steps});
      if (!std::exchange(parts_[which[i]].touched, true)) touched_.push_back(which[i]);
    }
    due_[edges][(now_ + steps) % (kMostSteps + 1)].push_back(which[i]);
  }
  which.clear();
  std::sort(acts_.begin(), acts_.end());
  const auto each = [&](const auto& use) {
    for (const auto& act : acts_)
      for (const int element : parts_[act.first].at) use(crowd_[element]);
  };
  each([](std::uint8_t& n) { n += n < 255; });
  bool deep = true;
  for (int pass = 0; pass < kPasses && deep; ++pass) {
    deep = false;
    for (const auto& [part, steps] : acts_) deep |= resolve(part, edges, steps, pass == 0);
  }
  each([](std::uint8_t& n) { n = 0; });
}

// Coulomb's friction takes up to mu times the normal change of velocity from the sliding speed. What comes nearer than
// a layer within the step does not: vertices lie where their new velocities would have taken them. What is nearer
// already is moved apart, and what went through goes back at once.
// Whether it was nearer than half a layer.
template <class T>
bool SelfContact<T>::resolve(int part, bool edges, int steps, bool first) {
  const int width = strips_->width;
  const std::array<int, 4>& place = parts_[part].at;
  Vec<T> x[4], v[4], d = {0, 0, 0}, u = {0, 0, 0};
  T share[4], give = 0;
  for (int q = 0; q < 4; ++q) {
    const T *const px = f_.x + place[q], *const pv = f_.v + place[q];
    x[q] = {px[0], px[width], px[2 * width]}, v[q] = {pv[0], pv[width], pv[2 * width]};
  }
  edges ? nearest_on_edges(x, share) : nearest_in_triangle(x, share);
  for (int q = 0; q < 4; ++q)
    d = d + share[q] * x[q], u = u + share[q] * v[q], give += share[q] * share[q] * mobility_[place[q]];
  const Vec<T> side = vec(parts_[part].side);
  const T far = std::sqrt(dot(d, d)), apart = dot(d, side) < 0 ? -far : far, gap = apart - layer_;
  const Vec<T> n = far > T(1e-6) ? d / apart : side;
  const T un = dot(u, n), time = h_ * T(steps), least = gap > 0 ? -gap / time : T(0), stop = std::max(least - un, T(0));
  if (!(give > 0) || !(stop > 0 || gap < 0)) return false;
  int crowd = 1;
  for (const int element : place) crowd = std::max<int>(crowd, crowd_[element]);
  const T slow = first && gap < 0 ? time * std::min(-gap / T(kRelax), T(kCreep)) / T(crowd) : T(0);
  const T more = apart < 0 ? std::min(far, layer_) : slow;
  const Vec<T> slide = u - un * n;
  const T sliding = std::sqrt(dot(slide, slide)),
          hold = sliding > 0 ? std::min(friction_ * stop / sliding, T(1)) : T(0);
  for (int q = 0; q < 4; ++q) {
    const T part_of = mobility_[place[q]] * share[q] / give;
    const Vec<T> kick = part_of * (stop * n - hold * slide), w = v[q] + kick;
    const Vec<T> to = x[q] + h_ * kick + (part_of * more) * n, y = to + damping_ * w;
    T *const px = f_.x + place[q], *const pv = f_.v + place[q], *const py = f_.y + place[q];
    px[0] = to.x, px[width] = to.y, px[2 * width] = to.z;
    pv[0] = w.x, pv[width] = w.y, pv[2 * width] = w.z;
    py[0] = y.x, py[width] = y.y, py[2 * width] = y.z;
  }
  return gap < -layer_ / 2;
}

template bool SelfContact<float>::resolve(int, bool, int, bool);
template bool SelfContact<double>::resolve(int, bool, int, bool);
template void SelfContact<float>::look(bool, std::vector<int>&);
template void SelfContact<double>::look(bool, std::vector<int>&);

}  // namespace minicloth
