// Chooses the widest instruction set that this processor has.
#include "lanes.hpp"

namespace minicloth {

#define DECLARE(name)                 \
  namespace name {                    \
  const Lanes<float>& lanes(float);   \
  const Lanes<double>& lanes(double); \
  }
DECLARE(baseline)
#ifdef MINICLOTH_X86_LEVELS
DECLARE(avx2)
DECLARE(avx512)
#endif
#undef DECLARE

namespace {
int level() {
#ifdef MINICLOTH_X86_LEVELS
  __builtin_cpu_init();
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq") &&
      __builtin_cpu_supports("avx512bw"))
    return 2;
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) return 1;
#endif
  return 0;
}
const int kLevel = level();
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

const char* best_lanes_name() {
  static const char* const names[] = {"baseline", "avx2", "avx512"};
  return names[kLevel];
}

}  // namespace minicloth
