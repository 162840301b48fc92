// A spring that may yield when it is shortened, with its dashpot.
#pragma once
#include "../base/simd.hpp"

namespace minicloth {
namespace LANES {
namespace {

template <class T>
inline V<T> square(const V3<T>& d) {
  return d.x * d.x + (d.y * d.y + (d.z * d.z + tiny<T>));
}

// A spring shortened by e has the tension -k c (min(e, b) + q max(e - b, 0)), b the length at which it buckles. On top
// of a linear spring's -k e that is k (1 - c q) e and -k c (1 - q) min(e, b).
template <class T>
struct Yielding {
  V<T> yields, buckled, buckling, shortened_damping;  // c q - 1, c - c q, b over the length, times damping
};

// What it pulls with over d, k (|d| - L) / |d| of a linear one; e is d a moment `damping` later.
template <class T>
__attribute__((always_inline)) inline V<T> yielding_pull(const V3<T>& d, const V3<T>& e, const V<T>& k,
                                                         const V<T>& length, const Yielding<T>& y) {
  const V<T> none = {};
  const V<T> inverse = rsqrt(square<T>(d)), ratio = length * inverse, extra = T(1) - ratio;
  const V<T> shorter = extra < T(0) ? extra : none, limit = -y.buckling * ratio;
  const V<T> rate = extra < T(0) ? y.shortened_damping : none + T(1);
  const V<T> damped = dot(d, e - d) * (inverse * inverse);  // damping d . w / |d|^2
  return k * (extra + y.yields * shorter + y.buckled * (shorter > limit ? shorter : limit) + rate * damped);
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
