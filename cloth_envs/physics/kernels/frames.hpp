// What the compiled solvers share: threads over a batch, and the motion of driven things through a frame.
#pragma once
#include <algorithm>
#include <cstddef>
#include <thread>
#include <vector>
#if defined(__SSE2__)
#include <xmmintrin.h>
#endif

namespace minicloth {

// Denormal numbers are slow and mean nothing here; the caller's setting comes back at the end.
struct FlushDenormals {
#if defined(__SSE2__)
  unsigned saved = _mm_getcsr();
  FlushDenormals() { _mm_setcsr(saved | 0x8040u); }
  ~FlushDenormals() { _mm_setcsr(saved); }
#endif
};

// Cubic Hermite motion over a frame.
struct Cubic {
  double p0, v0, p1, v1;  // v [per frame]
  double c2 = 3 * (p1 - p0) - 2 * v0 - v1, c3 = 2 * (p0 - p1) + v0 + v1;
  double position(double s) const { return p0 + s * (v0 + s * (c2 + s * c3)); }
  double velocity(double s) const { return v0 + s * (2 * c2 + s * 3 * c3); }
};

// A driven vertex; one that is held still costs two stores a substep.
struct Driven {
  int index;
  bool moves;
  Cubic path[3];
};

// Calls work(member) for a batch. Results do not depend on threads: a member is one thread's from start to end.
template <class Work>
void for_each_member(std::size_t batch, int threads, const Work& work) {
  const int count = std::min<int>(threads, int(batch));
  const auto share = [&](int first) {
    const FlushDenormals flush;
    for (std::size_t i = first; i < batch; i += count) work(i);
  };
  std::vector<std::thread> pool;
  for (int t = 1; t < count; ++t) pool.emplace_back(share, t);
  share(0);
  for (auto& t : pool) t.join();
}

}  // namespace minicloth
