// Threads over the members of a batch.
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
