// What springs pull with, in vectors. Included where it is compiled for an instruction set.
#pragma once
#include "../sheet/yielding.hpp"
#include "ghosts.hpp"

namespace minicloth {
namespace LANES {
namespace {

// A spring's k, and L k times the numbers of rsqrt's Newton step.
template <class T>
struct Spring {
  V<T> k, half, most, length;
  Spring(const V<T>& k_, T length_)
      : k(k_), half((T(0.5) * length_) * k_), most((T(1.5) * length_) * k_), length(V<T>{} + length_) {}
};

// k (1 - L / sqrt(square)) of four springs; their instructions are interleaved, so that none waits for the one before.
inline void pull(V<float> (&q)[4], const Spring<float>* const (&s)[4]) {
  V<float> e[4], p[4];
  for (int i = 0; i < 4; ++i) e[i] = rsqrt_estimate(q[i]);
  for (int i = 0; i < 4; ++i) p[i] = q[i] * e[i];
  for (int i = 0; i < 4; ++i) p[i] = p[i] * e[i];
  for (int i = 0; i < 4; ++i) p[i] = p[i] * s[i]->half - s[i]->most;
  for (int i = 0; i < 4; ++i) q[i] = p[i] * e[i] + s[i]->k;
}
inline void pull(V<double> (&q)[4], const Spring<double>* const (&s)[4]) {
  for (int i = 0; i < 4; ++i) q[i] = s[i]->k - s[i]->k * (s[i]->length * rsqrt(q[i]));
}

// What springs pull to: the force is to - over * x, where `over` is the sum of what they pull with over their length.
template <class T>
struct Pulls {
  V3<T> to;
  V<T> over;
};
template <class T>
inline Pulls<T> operator+(const Pulls<T>& a, const Pulls<T>& b) {
  return {a.to + b.to, a.over + b.over};
}
template <class T>
inline Pulls<T> towards(const V<T>& p, const V3<T>& x) {
  return {p * x, p};
}
template <class T>
inline Pulls<T> get_pulls(const T* at) {
  return {get<T>(at), load(at + 3 * kLanes<T>)};
}
template <class T>
inline void set_pulls(T* at, const Pulls<T>& p) {
  set<T>(at, p.to), store<T>(at + 3 * kLanes<T>, p.over);
}

template <class T>
inline Pulls<T> earlier(const Pulls<T>& p) {
  const V<T> none = {};
  return {earlier(p.to), late(none, p.over)};
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
