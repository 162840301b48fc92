// A frame of one cloth by one block: the steps of explicit/core.cpp, without contact of the cloth with itself.
#pragma once
#include "drives.hpp"
#include "slow.hpp"
#include "sound.hpp"
#include "springs.hpp"

namespace minicloth {
namespace LANES {
namespace {

// From substep `first` to the middle of the kicks before `end`, in substeps; a frame's first and last kick are half.
inline float middle(int first, int end, int count) {
  const float n = float(end - first), start = first == 0 ? 0.5f : 0.0f, stop = end > count ? 0.5f : 0.0f;
  return (n - 1) * (0.5f * n - stop) / (n - start - stop);
}

// The forces in the middle of the substeps from k on for which they are held, but for what `blow` adds. Velocities when
// they were last computed wait where those of the frame's end will be.
template <int kStrip>
__attribute__((always_inline)) inline void slow_forces(const CardSheet& s, const Shared& shared, int k,
                                                       const int (&cut)[2], float h, float* past,
                                                       Block<kStrip>& block) {
  const int count = cut[0], held = cut[1];
  const float steps = middle(k, k + held < count + 1 ? k + held : count + 1, count), later = h * steps;
  const float since = k > held ? float(held) : float(held) - 0.5f, trend = k ? (steps + 0.5f) / since : 0.0f;
  block.each([&](Own<kStrip>& own) __attribute__((always_inline)) {
    for_own(s, own, [&](int j, int i) __attribute__((always_inline)) {
      const int n = s.rows * s.cols;
      const V3<float> v = own.v[j];
      V3<float> then = v;
      if (s.air && k) then = {past[i], past[n + i], past[2 * n + i]};
      shared.put(s, i, own.x[j] + later * v, v + trend * (v - then));
      if (s.air) past[i] = v.x, past[n + i] = v.y, past[2 * n + i] = v.z;
    });
  });
  block.each([&](Own<kStrip>& own) __attribute__((always_inline)) { bend_strip(s, shared, own); });
}

// A cloth as it was at the frame's start.
template <int kStrip>
__attribute__((always_inline)) inline void get(const CardSheet& s, const CardBatch& batch, int member,
                                               Own<kStrip>& own) {
  const int n = s.rows * s.cols;
  for_own(s, own, [&](int j, int) __attribute__((always_inline)) {
    const float* const x = batch.x + std::size_t(3) * n * member + vertex(s, own, j);
    const float* const v = batch.v + std::size_t(3) * n * member + vertex(s, own, j);
    own.x[j] = {x[0], x[n], x[2 * n]}, own.v[j] = {v[0], v[n], v[2 * n]};
  });
}

template <bool kSimple, int kStrip>
__attribute__((always_inline)) inline void run(const CardSheet& s, const CardBatch& batch, int member,
                                               const int (&cut)[2], const Shared& shared, Block<kStrip>& block) {
  const CardCloth& m = *shared.cloth;
  const int count = cut[0], held = cut[1];
  const double length = s.frame_dt / count;
  const float h = float(length);
  const float over_count = 1.0f / float(count), damping = m.damping;
  float* const past = batch.v_out + std::size_t(3) * s.rows * s.cols * member;
  const bool forces = s.bends || s.air || s.pressure;
  block.each([&](Own<kStrip>& own) __attribute__((always_inline)) {
    get(s, batch, member, own);
    for_own(s, own, [&](int, int i) __attribute__((always_inline)) { shared.put_force(s, i, {0, 0, 0}); });
    if (own.number < 2) shared.kicks[own.number] = kick_of(s, m, length / (2 - own.number));
    for (int i = own.number; i < s.handles; i += block.threads)
      begin_handle(s, batch, m, member, i, length, shared.held[i]);
    for (int i = own.number; i < s.bodies; i += block.threads) begin_body(s, batch, member, i, shared.driven[i]);
  });
  for (int k = 0; k <= count; ++k) {
    const bool last = k == count, anew = forces && k % held == 0;
    if (anew) slow_forces(s, shared, k, cut, h, past, block);
    if (anew || k == 0)
      block.each([&](Own<kStrip>& own) __attribute__((always_inline)) {
        if (anew && (s.air || s.pressure) && own.row < s.rows) blow_strip(s, shared, own);
        for_own(s, own, [&](int j, int i) { shared.put(s, i, own.x[j], own.x[j] + damping * own.v[j]); });
      });
    const float dt = last ? h / 2 : h;
    block.each([&](Own<kStrip>& own) __attribute__((always_inline)) {
      kick_strip<kSimple>(s, shared, shared.kicks[k && !last], own);
      const float t = float(last ? count : k + 1) * over_count;
      for (int i = own.number; i < s.handles; i += block.threads) move_handle(s, t, shared.held[i]);
      for (int i = own.number; i < s.bodies; i += block.threads)
        move_body((k + (last ? 0.5 : 1)) / count, dt, shared.driven[i]);
    });
    block.each([&](Own<kStrip>& own) __attribute__((always_inline)) {
      for_own(s, own, [&](int j, int i) __attribute__((always_inline)) {
        const V3<float> start = own.x[j];
        if (s.soft && k == 0 && own.held >> j & 1) {  // the first step draws soft handles for a whole one
          const Held& held = shared.handle(s, i);
          own.v[j] = own.v[j] + shared.kicks[0].decay * pulled(held, way_of(held, start, held.rest), -h / 2);
        }
        V3<float> x = start + dt * own.v[j];
        keep_out(s, shared, start, x, own.v[j]);
        if (!last) own.x[j] = x;
      });
      if (s.handles && own.held)
        for_own(s, own, [&](int j, int i) __attribute__((always_inline)) {
          if (!(own.held >> j & 1)) return;
          const Held& held = shared.handle(s, i);
          hold(s, held, last ? 0.0f : h, own.x[j], own.v[j]);
          if (s.soft && last) own.v[j] = own.v[j] + pulled(held, way_of(held, own.x[j], held.ahead), h / 2);
        });
      for_own(s, own, [&](int j, int i) __attribute__((always_inline)) {
        shared.put(s, i, own.x[j], own.x[j] + damping * own.v[j]);
      });
    });
  }
}

// From the batch's start to its end. A frame is stepped again where its end is found to need shorter steps.
template <int kStrip>
__attribute__((always_inline)) inline void frame(const CardSheet& s, const CardBatch& batch, int member,
                                                 const Shared& shared, Block<kStrip>& block) {
  const CardCloth& m = *shared.cloth;
  const int n = s.rows * s.cols;
  const std::size_t first = std::size_t(3) * n * member;
  block.each([&](Own<kStrip>& own) __attribute__((always_inline)) {
    get(s, batch, member, own);
    own.held = 0;
    for_own(s, own, [&](int j, int i) __attribute__((always_inline)) {
      const int handle = s.handles ? batch.handle_of[vertex(s, own, j)] : -1;
      if (handle >= 0) shared.put_handle(s, i, handle), own.held |= 1 << j;
    });
    if (own.number) return;
    *shared.cloth = batch.cloths[member];
    *shared.weather = weather_of(s, batch.wind + 3 * std::size_t(member), batch.pressure[member]);
  });
  // What drives it may be faster than what it has at first.
  const Sound before = look(s, shared, block, [&](int number) {
    double speed = 0;
    const auto faster = [&](double v) { speed = (v < 0 ? -v : v) > speed ? (v < 0 ? -v : v) : speed; };
    for (int h = number; h < 3 * s.handles; h += block.threads) {
      const std::size_t i = std::size_t(3) * s.handles * member + h;
      faster(batch.handle_v[i]);
      faster((batch.handle_x[i] - batch.x[first + h % 3 * n + batch.handles[h / 3]]) / s.frame_dt);
    }
    for (int c = number; c < 6 * s.bodies; c += block.threads) {
      const std::size_t i = std::size_t(6) * s.bodies * member + c;
      faster(batch.body_v[i]), faster(batch.body_v_end[i]);
      faster((batch.body_x_end[i] - batch.body_x[i]) / s.frame_dt);
    }
    return float(speed);
  });
  const double stretch = before.strain > 0 ? 1 + before.strain : 1, p = batch.pressure[member];
  int level = level_of(s, m, before), cut[2];
  Sound after;
  for (;;) {
    cut_for(s, m, level, before.speed, (p < 0 ? -p : p) * stretch, cut);
#if !defined(MINICLOTH_ONLY_YIELDING)
    if (m.simple) run<true>(s, batch, member, cut, shared, block);
#endif
#if !defined(MINICLOTH_ONLY_SIMPLE)
    if (!m.simple) run<false>(s, batch, member, cut, shared, block);
#endif
    after = look(s, shared, block, [](int) { return 0.0f; });
    const int end = !after.finite && before.finite ? kLevels - 1 : level_of(s, m, after);
    if (end <= level) break;
    int next[2];
    level = end;
    cut_for(s, m, level, before.speed, (p < 0 ? -p : p) * stretch, next);
    if (next[0] == cut[0] && next[1] == cut[1]) break;
  }
  const float energy = kinetic(s, shared, block);
  block.each([&](Own<kStrip>& own) __attribute__((always_inline)) {
    for_own(s, own, [&](int j, int) __attribute__((always_inline)) {
      const std::size_t i = first + vertex(s, own, j);
      batch.x_out[i] = own.x[j].x, batch.x_out[i + n] = own.x[j].y, batch.x_out[i + 2 * n] = own.x[j].z;
      batch.v_out[i] = own.v[j].x, batch.v_out[i + n] = own.v[j].y, batch.v_out[i + 2 * n] = own.v[j].z;
    });
    if (own.number) return;
    batch.health[3 * member] = after.finite ? 1.0f : 0.0f, batch.health[3 * member + 1] = after.strain;
    batch.health[3 * member + 2] = energy;
    batch.taken[2 * member] = cut[0], batch.taken[2 * member + 1] = cut[1];
  });
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
