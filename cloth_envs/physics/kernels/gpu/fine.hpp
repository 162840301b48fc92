// Vertices of some fine cloths by one block, each interpolated between those of a coarse one, with what a network says
// of its cells (surrogates/upscale/local_features.py, nets/patch_lanes.cpp), put where handles are driven, outside all
// bodies (projection/fine.cpp).
#pragma once
#include "../base/simd.hpp"
#include "fine_terms.hpp"

namespace minicloth {
namespace LANES {
namespace {

constexpr int kSeen = 12, kSaid = 9;  // vertices of a patch; nodes of a cell
#if defined(__CUDACC_RTC__)
constexpr int kMostWide = MINICLOTH_WIDEST, kCloths = MINICLOTH_CLOTHS;  // numbers of a layer; cloths of a block
constexpr FineSheet kSheet = MINICLOTH_SHEET;                            // known when this is compiled
template <int kLayer>
constexpr int width(const FineSheet&) {
  return kSheet.widths[kLayer];
}
#else
constexpr int kMostWide = 252, kCloths = 4;
template <int kLayer>
int width(const FineSheet& s) {
  return s.widths[kLayer];
}
#endif

enum Count { kWanted, kCells, kBase, kSpeeds, kNodes, kHeld };

// The threads of a block share the work of a phase: thread by thread elsewhere, as in block.hpp.
#if defined(__CUDACC_RTC__)
struct Crew {
  template <class Act>
  __forceinline__ void each(int count, const Act& act) {
    for (int i = threadIdx.x; i < count; i += blockDim.x) act(i);
    __syncthreads();
  }
};
#else
struct Crew {
  bool backwards;
  template <class Act>
  void each(int count, const Act& act) {
    for (int i = 0; i < count; ++i) act(backwards ? count - 1 - i : i);
  }
};
#endif

struct alignas(16) Four {
  float w[4];
};
inline int fours(int inputs) { return (inputs + 3) / 4; }

inline int outputs_of(const FineSheet& s) {
  int count = 0;
  for (int l = 0; l < s.layers; ++l) count += s.widths[l + 1];
  return count;
}

// What a block shares: coarse cloths, continued by a vertex all around, their velocities, and the network.
struct Drawn {
  Four* weights;
  float *bias, *padded, *speeds, *said;  // of each cloth its own, (3, h + 2, w + 2), (3, h w), (9, 3, cells)

  static int weights_of(const FineSheet& s) {
    int count = 0;
    for (int l = 0; l < s.layers; ++l) count += fours(s.widths[l]) * s.widths[l + 1];
    return count;
  }
  static int padded_of(const FineSheet& s) { return 3 * (s.rows + 2) * (s.cols + 2); }
  static int speeds_of(const FineSheet& s) { return 3 * s.rows * s.cols; }
  Drawn(const FineSheet& s, unsigned char* memory, float* spare)
      : weights(reinterpret_cast<Four*>(memory)),
        bias(reinterpret_cast<float*>(weights + weights_of(s))),
        padded(bias + kCloths * outputs_of(s)),
        speeds(padded + kCloths * padded_of(s)),
        said(s.spare ? spare : speeds + kCloths * speeds_of(s)) {}
  static std::size_t bytes(const FineSheet& s, int cells, int cloths) {
    const std::size_t said = s.layers && !s.spare ? 3 * kSaid * std::size_t(cells) : 0;
    return weights_of(s) * sizeof(Four) + cloths * (outputs_of(s) + padded_of(s) + speeds_of(s) + said) * sizeof(float);
  }
};

// The number `i` of a row of `count`, of which `at` gives those that are there; a parabola continues it.
template <class At>
inline float continued(int i, int count, const At& at) {
  if (i < 0) return 3 * (at(0) - at(1)) + at(2);
  return i < count ? at(i) : 3 * (at(count - 1) - at(count - 2)) + at(count - 3);
}

inline V3<float> direction(const V3<float>& a) { return rsqrt(dot(a, a) + tiny<float>) * a; }

// A layer: rows and biases go on to the next one's. Loops over numbers in registers must not stay loops.
template <int kLayer>
__attribute__((always_inline)) inline void dense(const FineSheet& s, const Four*& row, const float*& bias,
                                                 const float (&from)[kMostWide], float (&to)[kMostWide]) {
  const int inputs = width<kLayer>(s), outputs = width<kLayer + 1>(s);
#pragma unroll
  for (int o = 0; o < outputs; ++o) {
    float sum = bias[o];
#pragma unroll
    for (int i = 0; i < inputs; i += 4) {
      const Four four = row[i / 4];
#pragma unroll
      for (int j = 0; j < 4; ++j)
        if (i + j < inputs) sum += four.w[j] * from[i + j];
    }
    to[o] = kLayer < s.layers - 1 && sum < 0 ? 0.0f : sum;
    row += fours(inputs);
  }
  bias += outputs;
}

// What the network says of the cell whose patch begins at `patch` in the continued sheet, to (9, 3) places `apart`.
__attribute__((always_inline)) inline void say(const FineSheet& s, const Four* row, const float* bias,
                                               const float* patch, int apart, float* said) {
  const int wide = s.cols + 2, plane = (s.rows + 2) * wide;
  V3<float> x[kSeen], mean = {0, 0, 0}, axes[3];
#pragma unroll
  for (int i = 0; i < kSeen; ++i) {
    constexpr int kPlaces[kSeen] = {1, 2, 4, 5, 6, 7, 8, 9, 10, 11, 13, 14};  // among 4 x 4
    const float* const p = patch + kPlaces[i] / 4 * wide + kPlaces[i] % 4;
    x[i] = {p[0], p[plane], p[2 * plane]}, mean = mean + x[i];
  }
  const V3<float> a = direction((x[4] + x[8]) - (x[3] + x[7])), b = direction((x[7] + x[8]) - (x[3] + x[4]));
  const V3<float> u = direction(a + b), d = a - b, v = direction(d - dot(u, d) * u);
  axes[0] = 0.70710678f * (u + v), axes[1] = 0.70710678f * (u - v), axes[2] = cross(axes[0], axes[1]);
  mean = 1.0f / kSeen * mean;
  float numbers[2][kMostWide];
  const float size = float(s.spacing), per = float(1 / s.spacing), tight = float(1 / (s.limit * s.limit));
#pragma unroll
  for (int i = 0; i < kSeen; ++i)
#pragma unroll
    for (int k = 0; k < 3; ++k) numbers[0][k * kSeen + i] = dot(axes[k], per * (x[i] - mean));
  static_assert(kMostLayers == 4);
  if (s.layers > 0) dense<0>(s, row, bias, numbers[0], numbers[1]);
  if (s.layers > 1) dense<1>(s, row, bias, numbers[1], numbers[0]);
  if (s.layers > 2) dense<2>(s, row, bias, numbers[0], numbers[1]);
  if (s.layers > 3) dense<3>(s, row, bias, numbers[1], numbers[0]);
#pragma unroll
  for (int i = 0; i < kSaid; ++i) {
    const float* const y = numbers[s.layers % 2] + i;
    const V3<float> in = {y[0], y[kSaid], y[2 * kSaid]};
    const float scale = size * rsqrt(1 + tight * dot(in, in));  // shortened, to `limit` at most
    const V3<float> out = scale * ((in.x * axes[0] + in.y * axes[1]) + in.z * axes[2]);
    said[(3 * i) * apart] = out.x, said[(3 * i + 1) * apart] = out.y, said[(3 * i + 2) * apart] = out.z;
  }
}

// Adds row k of a matrix times three fields of each cloth. Their numbers lie `step` apart, the fields `apart`, those of
// cloths, of which there are `here`, `each`.
template <class T>
__attribute__((always_inline)) inline void add_row(const Sparse& m, int most, int rows, int k, const T* field, int step,
                                                   int apart, int each, int here, V3<float> (&sums)[kCloths]) {
#pragma unroll 2
  for (int e = 0; e < most; ++e) {
    const float by = m.by[e * rows + k];
    const T* const at = field + step * m.at[e * rows + k];
#pragma unroll
    for (int c = 0; c < kCloths; ++c) {
      const T* const mine = at + (c < here ? c : 0) * each;
      sums[c] = sums[c] + by * V3<float>{float(mine[0]), float(mine[apart]), float(mine[2 * apart])};
    }
  }
}

// Where a vertex is beside a body: the normal outwards, how far it is from the surface, how fast that is there.
struct Beside {
  V3<float> normal;
  float gap;
  V3<float> carried;
};
inline Beside beside(const CardBody& body, const float* ends, const float* moving, const V3<float>& x) {
  const auto three = [](const float* p) { return V3<float>{p[0], p[1], p[2]}; };
  const V3<float> first = three(ends), second = three(ends + 3), velocity = three(moving);
  const float radius = float(body.radius);
  if (body.plane) return {second, dot(x - first, second) - radius, velocity};
  const V3<float> axis = second - first;
  const float along = dot(x - first, axis) / (dot(axis, axis) + tiny<float>);
  const float place = along < 0 ? 0.0f : along < 1 ? along : 1.0f;
  const V3<float> away = x - (first + place * axis);
  const float distance = sqrtf(dot(away, away)), up = distance == 0;  // from the axis itself
  const V3<float> normal = 1 / (distance + up) * away;
  return {{normal.x, normal.y, normal.z + up}, distance - radius, velocity + place * (three(moving + 3) - velocity)};
}

// Puts a vertex outside all bodies, and takes from it what of its speed leads into them.
inline void keep_off(const FineSheet& s, const FineBatch& b, std::size_t member, float free, V3<float>& at,
                     V3<float>& speed) {
  const float *const ends = b.body_x + member * 6 * s.bodies, *const moving = b.body_v + member * 6 * s.bodies;
  for (int sweep = 0; sweep < (s.bodies < 2 ? s.bodies : 2); ++sweep)
    for (int i = 0; i < s.bodies; ++i) {
      const Beside met = beside(b.bodies[i], ends + 6 * i, moving + 6 * i, at);
      if (met.gap < 0) at = at - free * met.gap * met.normal;
    }
  for (int i = 0; i < s.bodies; ++i) {
    const Beside met = beside(b.bodies[i], ends + 6 * i, moving + 6 * i, at);
    const float into = free * dot(speed - met.carried, met.normal);
    if (met.gap < float(s.reach) && into < 0) speed = speed - into * met.normal;
  }
}

// The vertices of the cloths from member `first` on, kCloths or what is left of them.
__attribute__((always_inline)) inline void fine(const FineSheet& s, const FineBatch& b, std::size_t first,
                                                const Drawn& drawn, Crew& crew) {
  const int n = s.rows * s.cols, wide = s.cols + 2, plane = (s.rows + 2) * wide, outputs = outputs_of(s);
  const int wanted = b.counts[kWanted], cells = b.counts[kCells];
  const int here = b.members - first < kCloths ? int(b.members - first) : kCloths;
  const float *const x = b.x + 3 * n * first, *const v = b.v + 3 * n * first, *const bias = b.bias + outputs * first;
  crew.each(3 * plane * here, [&](int i) {
    const float* const field = x + i / plane * n;
    drawn.padded[i] = continued(i % plane / wide - 1, s.rows, [&](int row) {
      return continued(i % wide - 1, s.cols, [&](int col) { return field[row * s.cols + col]; });
    });
  });
  crew.each(3 * n * here, [&](int i) { drawn.speeds[i] = v[i]; });
  if (s.layers) {
    crew.each(Drawn::weights_of(s), [&](int i) { drawn.weights[i] = reinterpret_cast<const Four*>(b.weights)[i]; });
    crew.each(outputs * here, [&](int i) { drawn.bias[i] = bias[i]; });
    crew.each(cells * here, [&](int i) __attribute__((always_inline)) {
      const int c = i / cells, cell = i % cells;
      say(s, drawn.weights, drawn.bias + c * outputs, drawn.padded + 3 * plane * c + b.cells[cell], cells,
          drawn.said + 3 * kSaid * cells * c + cell);
    });
  }
  crew.each(wanted, [&](int k) __attribute__((always_inline)) {
    V3<float> at[kCloths] = {}, speed[kCloths] = {};
    const double *const driven = b.driven + 3 * s.handles * first, *const driving = b.driving + 3 * s.handles * first;
    add_row(b.base, b.counts[kBase], wanted, k, drawn.padded, 1, plane, 3 * plane, here, at);
    if (s.layers) add_row(b.said_by, b.counts[kNodes], wanted, k, drawn.said, 1, cells, 3 * kSaid * cells, here, at);
    add_row(b.speeds, b.counts[kSpeeds], wanted, k, drawn.speeds, 1, n, 3 * n, here, speed);
    add_row(b.held, b.counts[kHeld], wanted, k, driven, 3, 1, 3 * s.handles, here, at);
    add_row(b.held, b.counts[kHeld], wanted, k, driving, 3, 1, 3 * s.handles, here, speed);
#pragma unroll
    for (int c = 0; c < kCloths; ++c) {
      if (c >= here) break;
      keep_off(s, b, first + c, b.free[k], at[c], speed[c]);
      const std::size_t to = 3 * b.room * (first + c) + b.places[k];
      b.x_out[to] = at[c].x, b.x_out[to + b.room] = at[c].y, b.x_out[to + 2 * b.room] = at[c].z;
      b.v_out[to] = speed[c].x, b.v_out[to + b.room] = speed[c].y, b.v_out[to + 2 * b.room] = speed[c].z;
    }
  });
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
