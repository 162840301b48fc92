#include "dispatch.hpp"

#include <cstdlib>
#include <string_view>

namespace minicloth {
namespace {

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

int chosen() {
  const int most = supported();
  const char* wanted = std::getenv("MINICLOTH_INSTRUCTION_SET");
  for (int k = 0; wanted && k < most; ++k)
    if (std::string_view(wanted) == kSets[k]) return k;
  return most;
}

}  // namespace

const int kSet = chosen();

}  // namespace minicloth
