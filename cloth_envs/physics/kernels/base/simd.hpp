// Vectors as wide as the instruction set that this file is compiled for (GCC and Clang vector types), or single numbers
// where MINICLOTH_SCALAR is defined: on a graphics card every thread is a lane.
#pragma once
#ifdef MINICLOTH_SCALAR
#include "scalar.hpp"
#else
#include <cmath>
#include <cstdint>
#include <cstring>
#if defined(__SSE2__)
#include <immintrin.h>
#endif

namespace minicloth {
namespace LANES {
namespace {

#if defined(__AVX512F__)
constexpr int kBytes = 64;
#elif defined(__AVX2__)
constexpr int kBytes = 32;
#else
constexpr int kBytes = 16;
#endif

template <class T>
struct Vector;
template <>
struct Vector<float> {
  typedef float type __attribute__((vector_size(kBytes)));
};
template <>
struct Vector<double> {
  typedef double type __attribute__((vector_size(kBytes)));
};
template <class T>
using V = typename Vector<T>::type;
template <class T>
constexpr int kLanes = kBytes / int(sizeof(T));

template <class T>
inline V<T> load(const T* p) {
  V<T> v;
  std::memcpy(&v, p, sizeof v);
  return v;
}
template <class T>
inline void store(T* p, const V<T>& v) {
  std::memcpy(p, &v, sizeof v);
}

#if defined(__AVX2__) && !defined(__AVX512F__)
inline __m256i first_lanes(int count) {
  return _mm256_cmpgt_epi32(_mm256_set1_epi32(count), _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7));
}
#endif
// The first `count` lanes from p on, of 0 or more; the others hold 0, and are not written.
inline V<float> load_few(const float* p, int count) {
#if defined(__AVX512F__)
  return (V<float>)_mm512_maskz_loadu_ps(__mmask16((1u << count) - 1), p);
#elif defined(__AVX2__)
  return (V<float>)_mm256_maskload_ps(p, first_lanes(count));
#else
  V<float> v = {};
  if (count == kLanes<float>)
    v = load(p);
  else
    std::memcpy(&v, p, count * sizeof(float));
  return v;
#endif
}
inline void store_few(float* p, const V<float>& v, int count) {
#if defined(__AVX512F__)
  _mm512_mask_storeu_ps(p, __mmask16((1u << count) - 1), (__m512)v);
#elif defined(__AVX2__)
  _mm256_maskstore_ps(p, first_lanes(count), (__m256)v);
#else
  if (count == kLanes<float>)
    store(p, v);
  else
    std::memcpy(p, &v, count * sizeof(float));
#endif
}

// Whether a comparison holds in some lane.
template <class T, class Mask>
inline bool any(const Mask& mask) {
#if defined(__AVX512F__)
  return sizeof(T) == 4 ? _mm512_test_epi32_mask((__m512i)mask, (__m512i)mask) != 0
                        : _mm512_test_epi64_mask((__m512i)mask, (__m512i)mask) != 0;
#elif defined(__AVX2__)
  return !_mm256_testz_si256((__m256i)mask, (__m256i)mask);
#elif defined(__SSE2__)
  return _mm_movemask_epi8((__m128i)mask) != 0;
#else
  bool found = false;
  for (int k = 0; k < kLanes<T>; ++k) found |= mask[k] != 0;
  return found;
#endif
}

// A bit for every lane in which a comparison holds.
template <class T, class Mask>
inline unsigned bits(const Mask& mask) {
#if defined(__AVX512F__)
  return unsigned(sizeof(T) == 4 ? _mm512_test_epi32_mask((__m512i)mask, (__m512i)mask)
                                 : _mm512_test_epi64_mask((__m512i)mask, (__m512i)mask));
#elif defined(__AVX2__)
  return unsigned(sizeof(T) == 4 ? _mm256_movemask_ps((__m256)mask) : _mm256_movemask_pd((__m256d)mask));
#elif defined(__SSE2__)
  return unsigned(sizeof(T) == 4 ? _mm_movemask_ps((__m128)mask) : _mm_movemask_pd((__m128d)mask));
#else
  unsigned found = 0;
  for (int k = 0; k < kLanes<T>; ++k) found |= unsigned(mask[k] != 0) << k;
  return found;
#endif
}

// A bit for every lane in which a < b.
template <class T>
inline unsigned less(const V<T>& a, const V<T>& b) {
#if defined(__AVX512F__)
  if constexpr (sizeof(T) == 4)
    return _mm512_cmp_ps_mask((__m512)a, (__m512)b, _CMP_LT_OQ);
  else
    return _mm512_cmp_pd_mask((__m512d)a, (__m512d)b, _CMP_LT_OQ);
#elif defined(__AVX2__)
  if constexpr (sizeof(T) == 4)
    return unsigned(_mm256_movemask_ps((__m256)(a < b)));
  else
    return unsigned(_mm256_movemask_pd((__m256d)(a < b)));
#elif defined(__SSE2__)
  if constexpr (sizeof(T) == 4)
    return unsigned(_mm_movemask_ps((__m128)(a < b)));
  else
    return unsigned(_mm_movemask_pd((__m128d)(a < b)));
#else
  unsigned found = 0;
  for (int k = 0; k < kLanes<T>; ++k) found |= unsigned(a[k] < b[k]) << k;
  return found;
#endif
}

// base[at[k]] in lane k.
template <class T>
inline V<T> gather(const T* base, const int* at) {
  V<T> v;
  for (int k = 0; k < kLanes<T>; ++k) v[k] = base[at[k]];
  return v;
}
#if defined(__AVX512F__)
template <>
inline V<float> gather(const float* base, const int* at) {
  return (V<float>)_mm512_i32gather_ps(_mm512_loadu_si512(at), base, 4);
}
#elif defined(__AVX2__)
template <>
inline V<float> gather(const float* base, const int* at) {
  return (V<float>)_mm256_i32gather_ps(base, _mm256_loadu_si256((const __m256i*)at), 4);
}
#endif

// The larger of every two.
inline V<float> larger(const V<float>& a, const V<float>& b) {
#if defined(__AVX512F__)
  return (V<float>)_mm512_max_ps((__m512)a, (__m512)b);
#elif defined(__AVX2__)
  return (V<float>)_mm256_max_ps((__m256)a, (__m256)b);
#elif defined(__SSE2__)
  return (V<float>)_mm_max_ps((__m128)a, (__m128)b);
#else
  return a > b ? a : b;
#endif
}

// About 1 / sqrt(v) for v > 0: 3e-4 relative or better, which one Newton step makes 1e-7.
inline V<float> rsqrt_estimate(V<float> v) {
#if defined(__AVX512F__)
  return (V<float>)_mm512_rsqrt14_ps((__m512)v);
#elif defined(__AVX2__)
  return (V<float>)_mm256_rsqrt_ps((__m256)v);
#elif defined(__SSE2__)
  return (V<float>)_mm_rsqrt_ps((__m128)v);
#else
  V<float> r;
  for (int k = 0; k < kLanes<float>; ++k) r[k] = 1.0f / std::sqrt(v[k]);
  return r;
#endif
}

// 1 / sqrt(v) for v > 0; float: an estimate and one Newton step.
inline V<float> rsqrt(V<float> v) {
  const V<float> r = rsqrt_estimate(v);
  return r * (1.5f - (0.5f * v) * (r * r));
}
inline V<double> rsqrt(V<double> v) {
#if defined(__AVX512F__)
  return 1.0 / (V<double>)_mm512_sqrt_pd((__m512d)v);
#elif defined(__AVX2__)
  return 1.0 / (V<double>)_mm256_sqrt_pd((__m256d)v);
#elif defined(__SSE2__)
  return 1.0 / (V<double>)_mm_sqrt_pd((__m128d)v);
#else
  V<double> r;
  for (int k = 0; k < kLanes<double>; ++k) r[k] = 1.0 / std::sqrt(v[k]);
  return r;
#endif
}

// 1 / v; float: an estimate and one Newton step.
inline V<float> reciprocal(V<float> v) {
#if defined(__AVX512F__)
  const V<float> r = (V<float>)_mm512_rcp14_ps((__m512)v);
#elif defined(__AVX2__)
  const V<float> r = (V<float>)_mm256_rcp_ps((__m256)v);
#elif defined(__SSE2__)
  const V<float> r = (V<float>)_mm_rcp_ps((__m128)v);
#else
  return 1.0f / v;
#endif
#if defined(__SSE2__)
  return r * (2.0f - v * r);
#endif
}
inline V<double> reciprocal(V<double> v) { return 1.0 / v; }

// The lanes of (a, b) one place later: the last of a, then b without its last.
template <class T>
inline T late(const T& a, const T& b) {
  constexpr int n = int(sizeof(a) / sizeof(a[0]));
#if defined(__clang__)
  T r;
  for (int k = 0; k < n; ++k) r[k] = k ? b[k - 1] : a[n - 1];
  return r;
#else
  using Index = decltype(a < b);
  Index index;
  for (int k = 0; k < n; ++k) index[k] = n - 1 + k;
  return __builtin_shuffle(a, b, index);
#endif
}

// The lanes of a one place earlier, then 0.
template <class T>
inline T early(const T& a) {
  constexpr int n = int(sizeof(a) / sizeof(a[0]));
  const T none = {};
#if defined(__clang__)
  T r = none;
  for (int k = 1; k < n; ++k) r[k - 1] = a[k];
  return r;
#else
  using Index = decltype(a < none);
  Index index;
  for (int k = 0; k < n; ++k) index[k] = k + 1;
  return __builtin_shuffle(a, none, index);
#endif
}

// Lanes of (a, b), picked by number: those of b follow those of a.
using Places = decltype(V<float>{} < V<float>{});
template <class T, class Number>
inline T pick(const T& a, const T& b, const Number& number) {
#if defined(__clang__)
  constexpr int n = int(sizeof(a) / sizeof(a[0]));
  T r;
  for (int k = 0; k < n; ++k) r[k] = number[k] < n ? a[number[k]] : b[number[k] - n];
  return r;
#else
  return __builtin_shuffle(a, b, number);
#endif
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
#endif

namespace minicloth {
namespace LANES {
namespace {

template <class T>
struct V3 {
  V<T> x, y, z;
};
template <class T>
inline V3<T> operator-(const V3<T>& a, const V3<T>& b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
template <class T>
inline V3<T> operator+(const V3<T>& a, const V3<T>& b) {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
template <class T>
inline V3<T> operator*(const V<T>& s, const V3<T>& a) {
  return {s * a.x, s * a.y, s * a.z};
}
template <class T>
inline V<T> dot(const V3<T>& a, const V3<T>& b) {
  return a.x * b.x + (a.y * b.y + a.z * b.z);
}
template <class T>
inline V3<T> cross(const V3<T>& a, const V3<T>& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// Three planes of one vector field.
template <class T>
constexpr T tiny = T(1e-20);  // keeps ghosts, which all lie at the origin, finite

template <class T>
inline V3<T> at(T* const (&planes)[3], int i) {
  return {load<T>(planes[0] + i), load<T>(planes[1] + i), load<T>(planes[2] + i)};
}
template <class T>
inline void put(T* const (&planes)[3], int i, const V3<T>& v) {
  store<T>(planes[0] + i, v.x), store<T>(planes[1] + i, v.y), store<T>(planes[2] + i, v.z);
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
