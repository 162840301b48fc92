// What simd.hpp has of vectors, of one lane.
#pragma once
#if !defined(__CUDACC_RTC__)
#include <cmath>
#endif

namespace minicloth {
namespace LANES {
namespace {

template <class T>
struct Vector {
  typedef T type;
};
template <class T>
using V = typename Vector<T>::type;
template <class T>
constexpr int kLanes = 1;

template <class T>
inline V<T> load(const T* p) {
  return *p;
}
template <class T>
inline void store(T* p, const V<T>& v) {
  *p = v;
}
template <class T>
inline bool any(bool mask) {
  return mask;
}
#if defined(__CUDACC_RTC__)
inline float rsqrt(float v) { return rsqrtf(v); }
inline float reciprocal(float v) { return __fdividef(1.0f, v); }
#else
inline float rsqrt(float v) { return 1.0f / std::sqrt(v); }
inline float reciprocal(float v) { return 1.0f / v; }
#endif

}  // namespace
}  // namespace LANES
}  // namespace minicloth
