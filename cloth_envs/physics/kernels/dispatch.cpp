// Chooses the widest instruction set that this processor has.
#include <cstdlib>
#include <string_view>

#include "admm.hpp"
#include "correct.hpp"
#include "lanes.hpp"
#include "particles.hpp"
#include "resample.hpp"
#include "upscale.hpp"

namespace minicloth {

#define DECLARE(name)                          \
  namespace name {                             \
  const Lanes<float>& lanes(float);            \
  const Lanes<double>& lanes(double);          \
  const NetLanes<float>& net_lanes(float);     \
  const NetLanes<double>& net_lanes(double);   \
  const AdmmLanes<float>& admm_lanes(float);   \
  const AdmmLanes<double>& admm_lanes(double); \
  const UpscaleLanes& upscale_lanes();         \
  Corrects correct_lanes();                    \
  Resample resample_lanes();                   \
  }
DECLARE(baseline)
#ifdef MINICLOTH_X86_LEVELS
DECLARE(avx2)
DECLARE(avx512)
#endif
#undef DECLARE

namespace {
const char* const kNames[] = {"baseline", "avx2", "avx512"};

int supported() {
#ifdef MINICLOTH_X86_LEVELS
  __builtin_cpu_init();
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq") &&
      __builtin_cpu_supports("avx512bw"))
    return 2;
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) return 1;
#endif
  return 0;
}

// MINICLOTH_INSTRUCTION_SET asks for a lesser set, so that all of them can be tested on one machine.
int chosen() {
  const int most = supported();
  const char* wanted = std::getenv("MINICLOTH_INSTRUCTION_SET");
  for (int k = 0; wanted && k < most; ++k)
    if (std::string_view(wanted) == kNames[k]) return k;
  return most;
}
const int kLevel = chosen();
}  // namespace

template <class T>
const Lanes<T>& best_lanes() {
#ifdef MINICLOTH_X86_LEVELS
  if (kLevel == 2) return avx512::lanes(T{});
  if (kLevel == 1) return avx2::lanes(T{});
#endif
  return baseline::lanes(T{});
}
template const Lanes<float>& best_lanes<float>();
template const Lanes<double>& best_lanes<double>();

template <class T>
const NetLanes<T>& best_net_lanes() {
#ifdef MINICLOTH_X86_LEVELS
  if (kLevel == 2) return avx512::net_lanes(T{});
  if (kLevel == 1) return avx2::net_lanes(T{});
#endif
  return baseline::net_lanes(T{});
}
template const NetLanes<float>& best_net_lanes<float>();
template const NetLanes<double>& best_net_lanes<double>();

template <class T>
const AdmmLanes<T>& best_admm_lanes() {
#ifdef MINICLOTH_X86_LEVELS
  if (kLevel == 2) return avx512::admm_lanes(T{});
  if (kLevel == 1) return avx2::admm_lanes(T{});
#endif
  return baseline::admm_lanes(T{});
}
template const AdmmLanes<float>& best_admm_lanes<float>();
template const AdmmLanes<double>& best_admm_lanes<double>();

const UpscaleLanes& best_upscale_lanes() {
#ifdef MINICLOTH_X86_LEVELS
  if (kLevel == 2) return avx512::upscale_lanes();
  if (kLevel == 1) return avx2::upscale_lanes();
#endif
  return baseline::upscale_lanes();
}

Corrects best_correct() {
#ifdef MINICLOTH_X86_LEVELS
  if (kLevel == 2) return avx512::correct_lanes();
  if (kLevel == 1) return avx2::correct_lanes();
#endif
  return baseline::correct_lanes();
}

Resample best_resample() {
#ifdef MINICLOTH_X86_LEVELS
  if (kLevel == 2) return avx512::resample_lanes();
  if (kLevel == 1) return avx2::resample_lanes();
#endif
  return baseline::resample_lanes();
}

const char* best_lanes_name() { return kNames[kLevel]; }

}  // namespace minicloth
