// The threads that step one cloth together: on a card a block of them, elsewhere a loop over all of them, which is how
// tests run the same code. A frame is a row of phases; what one writes into shared memory the next ones read.
#pragma once
#include "../base/simd.hpp"
#include "terms.hpp"

namespace minicloth {
namespace LANES {
namespace {

// A thread's own vertices: kStrip below each other in one column.
template <int kStrip>
struct Own {
  int number, row, col, place, held;         // of the first one; bit j of `held` is set where the j-th is a handle
  V3<float> x[kStrip] = {}, v[kStrip] = {};  // m, m/s
};

// How many rows the last strip has: no other one has fewer.
template <int kStrip>
inline int whole(const CardSheet& s) {
  return s.rows - (s.rows - 1) / kStrip * kStrip;
}
// In shared memory the first vertices of all threads lie beside each other, in the threads' order, then their second
// ones, ...: whatever the columns, threads that follow each other meet no bank twice. Where the j-th ones begin, of
// which threads that end in the last row may have none:
template <int kStrip>
inline int layer(const CardSheet& s, int j) {
  return (j * ((s.rows - 1) / kStrip + 1) - (j > whole<kStrip>(s) ? j - whole<kStrip>(s) : 0)) * s.cols;
}
// Whether there is a row q below a thread's first one. Most are there for all threads.
template <int kStrip>
inline bool there(const CardSheet& s, const Own<kStrip>& own, int q) {
  return (q >= 0 || own.row + q >= 0) && (q < whole<kStrip>(s) || own.row + q < s.rows);
}
// Where what lies q rows below a thread's first vertex is; that vertex itself beyond the first and the last row.
template <int kStrip>
__attribute__((always_inline)) inline int place(const CardSheet& s, const Own<kStrip>& own, int q) {
  const int strips = (q + 2 * kStrip) / kStrip - 2;
  const int at = own.place + strips * s.cols + layer<kStrip>(s, q - strips * kStrip);
  return there(s, own, q) ? at : own.place;
}
// Whether it and the one above it are there, and whether rows on both sides of it are.
template <int kStrip>
inline bool linked(const CardSheet& s, const Own<kStrip>& own, int q) {
  return there(s, own, q - 1) && there(s, own, q);
}
template <int kStrip>
inline bool inner(const CardSheet& s, const Own<kStrip>& own, int q) {
  return there(s, own, q - 1) && there(s, own, q + 1);
}
// Its j-th vertex, as the batch numbers them.
template <int kStrip>
inline int vertex(const CardSheet& s, const Own<kStrip>& own, int j) {
  return (own.row + j) * s.cols + own.col;
}

// Calls act(j, place in shared memory) for them; there are fewer at the end of a column, and none of idle threads.
template <int kStrip, class Act>
__attribute__((always_inline)) inline void for_own(const CardSheet& s, const Own<kStrip>& own, const Act& act) {
#pragma unroll
  for (int j = 0; j < kStrip; ++j) {
    if ((j == 0 || j >= whole<kStrip>(s)) && own.row + j >= s.rows) break;
    act(j, own.place + layer<kStrip>(s, j));
  }
}

#if defined(__CUDACC_RTC__)
// Nothing is read ahead of it, nor kept from before of what follows from a thread's place: both crowd registers.
inline void in_order() { asm volatile("" ::: "memory"); }
inline void anew(int& row, int& col, int& place) { asm volatile("" : "+r"(row), "+r"(col), "+r"(place)); }
template <int kStrip>
struct Block {
  Own<kStrip>& own;
  int threads;
  template <class Phase>
  __forceinline__ void each(const Phase& phase) {
    anew(own.row, own.col, own.place);
    phase(own);
    __syncthreads();
  }
  // What shared memory holds after a phase; it may be overwritten then.
  template <class T>
  T read(const T* at) {
    const T value = *at;
    __syncthreads();
    return value;
  }
};
inline void largest(int* at, float value) {
  const int bits = __reduce_max_sync(0xffffffffu, __float_as_int(value > 0 ? value : 0.0f));
  if (threadIdx.x % 32 == 0) atomicMax(at, bits);
}
inline float as_float(int bits) { return __int_as_float(bits); }
inline void add_up(float* sums, int number, float value) {
  for (int way = 16; way > 0; way /= 2) value += __shfl_xor_sync(0xffffffffu, value, way);
  if (number % 32 == 0) sums[number / 32] = value;
}
#else
inline void in_order() {}
template <int kStrip>
struct Block {
  Own<kStrip>* own;
  int threads;
  bool backwards;
  template <class Phase>
  void each(const Phase& phase) {
    for (int t = 0; t < threads; ++t) phase(own[backwards ? threads - 1 - t : t]);
  }
  template <class T>
  T read(const T* at) {
    return *at;
  }
};
inline float as_float(int bits) {
  float value;
  std::memcpy(&value, &bits, sizeof value);
  return value;
}
inline void largest(int* at, float value) {
  int bits = 0;
  if (value > 0) std::memcpy(&bits, &value, sizeof bits);
  *at = bits > *at ? bits : *at;
}
inline void add_up(float* sums, int number, float value) { sums[number / 32 % 32] += value; }
#endif

}  // namespace
}  // namespace LANES
}  // namespace minicloth
