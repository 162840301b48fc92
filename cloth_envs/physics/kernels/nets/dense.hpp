// A dense layer, one lane a sample.
#pragma once
#include <cstddef>

#include "../base/geometry.hpp"
#ifdef LANES  // the loop, where it is compiled for an instruction set
#include "../base/simd.hpp"
#endif

namespace minicloth {

constexpr int kWidest = 256;  // numbers that a layer may have

// kTogether outputs are summed at a time. The weight of input f to output kTogether * b + k is
// weights[(b * inputs + f) * kTogether + k].
template <int kTogether>
struct DenseLayer {
  int inputs = 0, outputs = 0;
  Plane<float> weights;

  DenseLayer() = default;
  // From rows of weights (outputs, inputs).
  DenseLayer(const float* rows, int outputs, int inputs) : inputs(inputs), outputs(outputs) {
    const int blocks = (outputs + kTogether - 1) / kTogether;
    weights.assign(std::size_t(blocks) * inputs * kTogether, 0.0f);
    for (int j = 0; j < outputs; ++j)
      for (int f = 0; f < inputs; ++f)
        weights[(std::size_t(j / kTogether) * inputs + f) * kTogether + j % kTogether] = rows[j * inputs + f];
  }
  bool fits() const { return inputs <= kWidest && (outputs + kTogether - 1) / kTogether * kTogether <= kWidest; }
};

#ifdef LANES
namespace LANES {
namespace {

// y = W x + b, and 0 where that is negative if kCut. Writes whole blocks of outputs.
template <bool kCut, int kTogether>
void dense(const DenseLayer<kTogether>& layer, const float* bias, const V<float>* x, V<float>* y) {
  const float* w = layer.weights.data();
  for (int j = 0; j < layer.outputs; j += kTogether) {
    V<float> sum[kTogether] = {};
    for (int f = 0; f < layer.inputs; ++f, w += kTogether) {
      const V<float> in = x[f];
#pragma GCC unroll 16
      for (int k = 0; k < kTogether; ++k) sum[k] += w[k] * in;
    }
#pragma GCC unroll 16
    for (int k = 0; k < kTogether; ++k) {
      const V<float> value = sum[k] + (j + k < layer.outputs ? bias[j + k] : 0.0f);
      y[j + k] = kCut ? (value > 0.0f ? value : V<float>{}) : value;
    }
  }
}

}  // namespace
}  // namespace LANES
#endif

}  // namespace minicloth
