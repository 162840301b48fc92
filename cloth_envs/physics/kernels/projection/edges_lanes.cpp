// Compiled once per instruction set; LANES names the namespace.
#include "../base/simd.hpp"
#include "edges.hpp"

namespace minicloth {
namespace LANES {
namespace {

using F = V<float>;
constexpr int kWide = kLanes<float>;

// Moves both ends of kWide edges by half of what they are too long or too short, times a share.
template <bool masked>
inline void pull(const Edges& e, int i, std::size_t plane, const F& part, float* x) {
  float* const a = x + e.from + i;
  float* const b = x + e.to + i;
  const V3<float> p = {load(a), load(a + plane), load(a + 2 * plane)};
  const V3<float> q = {load(b), load(b + plane), load(b + 2 * plane)};
  const V3<float> d = q - p;
  const F over = 1.0f - e.length * rsqrt(dot(d, d) + tiny<float>);  // strain over stretch
  F share = (over > 0.0f ? F{} + e.longer : F{} + e.shorter) * (0.5f * over) * part;
  if (masked) share *= load(e.shares + i);
  store(a, p.x + share * d.x), store(a + plane, p.y + share * d.y), store(a + 2 * plane, p.z + share * d.z);
  store(b, q.x - share * d.x), store(b + plane, q.y - share * d.y), store(b + 2 * plane, q.z - share * d.z);
}

template <bool masked>
void loop(const Edges& e, std::size_t plane, float* x) {
  const F all = F{} + 1.0f;
  int i = 0;
  for (; i + kWide <= e.count; i += kWide) pull<masked>(e, i, plane, all, x);
  if (i == e.count) return;
  F few = {};
  for (int k = 0; k < e.count - i; ++k) few[k] = 1.0f;
  pull<masked>(e, i, plane, few, x);
}

void mend(const Weave& weave, int sweeps, float keep, const int* held, std::size_t count, float* x, float* offset) {
  const std::size_t whole = weave.size(), n = std::size_t(weave.rows) * weave.cols;
  thread_local Plane<float> memory;
  memory.assign(3 * whole + kBlock, 0.0f);
  float* const y = memory.data();
  const auto each = [&](const auto& work) {  // every row of the cloth, and where its even and odd columns are
    for (int k = 0; k < 3; ++k)
      for (int r = 0; r < weave.rows; ++r) work(k * n + std::size_t(r) * weave.cols, y + k * whole + weave.at(r, 0), y + k * whole + weave.at(r, 1));
  };
  each([&](std::size_t i, float* even, float* odd) {
    for (int c = 0; c < weave.cols / 2; ++c)
      even[c] = x[i + 2 * c] + keep * offset[i + 2 * c], odd[c] = x[i + 2 * c + 1] + keep * offset[i + 2 * c + 1];
    if (weave.cols % 2) even[weave.cols / 2] = x[i + weave.cols - 1] + keep * offset[i + weave.cols - 1];
  });
  const auto hold = [&] {
    for (std::size_t j = 0; j < count; ++j)
      for (int k = 0; k < 3; ++k)
        y[k * whole + weave.at(held[j] / weave.cols, held[j] % weave.cols)] = x[k * n + held[j]];
  };
  hold();
  for (int s = 0; s < sweeps; ++s) {
    for (const Edges& e : weave.loops) e.shares ? loop<true>(e, whole, y) : loop<false>(e, whole, y);
    hold();
  }
  each([&](std::size_t i, float* even, float* odd) {
    const auto back = [&](std::size_t j, float now) { offset[j] = now - x[j], x[j] = now; };
    for (int c = 0; c < weave.cols / 2; ++c) back(i + 2 * c, even[c]), back(i + 2 * c + 1, odd[c]);
    if (weave.cols % 2) back(i + weave.cols - 1, even[weave.cols / 2]);
  });
}

constexpr EdgeLanes instance = {mend};

}  // namespace
}  // namespace LANES

DEFINE_LANES(EdgeLanes, instance)

}  // namespace minicloth
