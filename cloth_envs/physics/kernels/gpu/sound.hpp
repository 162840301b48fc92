// What is asked of a cloth at a frame's start and end: how it must be stepped, and whether it is sound.
#pragma once
#include "block.hpp"
#include "shared.hpp"

namespace minicloth {
namespace LANES {
namespace {

inline V3<float> field_a(const CardSheet& s, const Shared& shared, int i) {
  const int n = s.rows * s.cols;
  return {shared.field[i].a, shared.field[n + i].a, shared.field[2 * n + i].a};
}
inline V3<float> field_b(const CardSheet& s, const Shared& shared, int i) {
  const int n = s.rows * s.cols;
  return {shared.field[i].b, shared.field[n + i].b, shared.field[2 * n + i].b};
}
inline float size(float a) { return a < 0 ? -a : a; }

// The shear of an inner vertex' cells as slant of explicit/shear.hpp [m^2].
inline float slant(const V3<float>& at, const V3<float>& up, const V3<float>& down, const V3<float>& left,
                   const V3<float>& right) {
  const V3<float> fall[2] = {at - up, down - at}, along[2] = {at - left, right - at};
  float corner[2][2];
  for (int i = 0; i < 2; ++i)
    for (int j = 0; j < 2; ++j) corner[i][j] = dot(fall[i], along[j]);
  const float one = size(corner[0][0] + corner[0][1]) + size(corner[1][0] + corner[1][1]);
  const float other = size(corner[0][0] - corner[0][1]) + size(corner[1][0] - corner[1][1]);
  return one > other ? one : other;
}

struct Sound {
  bool finite;
  float shear, apart, strain, speed;  // a sine, m/s, 1, m/s
};

// Of positions and velocities, which are in shared memory as `a` and `b` then. Other speeds that count are those that
// each thread is told of by its number.
template <int kStrip, class Others>
__attribute__((always_inline)) inline Sound look(const CardSheet& s, const Shared& shared, Block<kStrip>& block,
                                                 const Others& others) {
  block.each([&](Own<kStrip>& own) __attribute__((always_inline)) {
    if (own.number == 0)
      for (int k = 0; k < Shared::kSums; ++k) shared.slots[k % kSlots] = 0, shared.sums[k] = 0;
    for_own(s, own, [&](int j, int i) __attribute__((always_inline)) { shared.put(s, i, own.x[j], own.v[j]); });
  });
  block.each([&](Own<kStrip>& own) __attribute__((always_inline)) {
    const float over_row = float(1 / (s.row_length * s.row_length)),
                over_col = float(1 / (s.col_length * s.col_length));
    float shear = 0, apart = 0, bad = 0, longest = 0, speed = others(own.number);
    const auto most = [](float& found, float value) { found = value > found ? value : found; };
    for_own(s, own, [&](int j, int i) __attribute__((always_inline)) {
      const int r = own.row + j, c = own.col;
      const V3<float> at = own.x[j], v = own.v[j];
      const float none = 0 * (at.x + at.y + at.z + v.x + v.y + v.z);
      bad = none == 0 ? bad : 1.0f;
      most(speed, size(v.x)), most(speed, size(v.y)), most(speed, size(v.z));
      if (c > 0 || s.periodic) {
        const int left = c > 0 ? i - 1 : i + s.cols - 1;
        const V3<float> d = at - field_a(s, shared, left), w = v - field_b(s, shared, left);
        most(longest, dot(d, d) * over_col);
        if (c > 0) most(apart, dot(w, w));
      }
      const int up = place(s, own, j - 1), down = place(s, own, j + 1);
      if (r > 0) {
        const V3<float> d = at - field_a(s, shared, up), w = v - field_b(s, shared, up);
        most(longest, dot(d, d) * over_row), most(apart, dot(w, w));
      }
      if (r > 0 && r < s.rows - 1 && c > 0 && c < s.cols - 1)
        most(shear, slant(at, field_a(s, shared, up), field_a(s, shared, down), field_a(s, shared, i - 1),
                          field_a(s, shared, i + 1)));
    });
    largest(shared.slots + kShear, shear), largest(shared.slots + kApart, apart), largest(shared.slots + kBad, bad);
    largest(shared.slots + kStrain, longest), largest(shared.slots + kSpeed, speed);
  });
  const float shear = as_float(block.read(shared.slots + kShear)), apart = as_float(block.read(shared.slots + kApart));
  const float strain = as_float(block.read(shared.slots + kStrain)),
              speed = as_float(block.read(shared.slots + kSpeed));
  const bool finite = block.read(shared.slots + kBad) == 0;
  return {finite, shear * float(0.25 / (s.row_length * s.col_length)), sqrtf(apart), sqrtf(strain) - 1, speed};
}

// Which cuts hold.
inline int level_of(const CardSheet& s, const CardCloth& m, const Sound& sound) {
  if (sound.apart > m.parting) return kLevels - 1;
  return sound.shear <= s.sheared ? 0 : sound.shear <= s.most_sheared ? 1 : 2;
}

// How a frame is cut that may be faster or under more pressure than usual: as much shorter steps as any of these can
// ask for, with nothing held. 1 / h is at most what it is without them, and half their rate or root of stiffness more.
inline void cut_for(const CardSheet& s, const CardCloth& m, int level, double speed, double load, int (&cut)[2]) {
  cut[0] = m.cuts[level][0], cut[1] = m.cuts[level][1];
  double more = 0;
  if (s.air && speed > s.fastest) {
    const double most = 4 * speed + s.max_wind;
    more += m.air * ((most < 340 ? most : 340) - s.fastest);
  }
  if (s.pressure && load > s.usual_pressure) more += sqrt(m.push * (load - s.usual_pressure));
  if (more == 0) return;
  const double count = ceil(s.frame_dt * more / 1.8) * (level < kLevels - 1 ? 1 : 4) + cut[0];
  cut[0] = count < 20000 ? int(count) : 20000, cut[1] = 1;
}

// The kinetic energy over the mass, vertices weighted alike [J/kg]; after look.
template <int kStrip>
__attribute__((always_inline)) inline float kinetic(const CardSheet& s, const Shared& shared, Block<kStrip>& block) {
  block.each([&](Own<kStrip>& own) __attribute__((always_inline)) {
    float sum = 0;
    for_own(s, own, [&](int j, int) __attribute__((always_inline)) { sum += dot(own.v[j], own.v[j]); });
    add_up(shared.sums, own.number, sum);
  });
  float all = 0;
  for (int k = 0; k < Shared::kSums; ++k) all += shared.sums[k];
  return 0.5f * all / float(s.rows * s.cols);
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
