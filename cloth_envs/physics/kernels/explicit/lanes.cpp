// Compiled once per instruction set; LANES names the namespace.
#include <algorithm>
#include <type_traits>

#include "../base/simd.hpp"
#include "../sheet/contact.hpp"
#include "core.hpp"
#include "slow.hpp"
#include "step.hpp"

namespace minicloth {
namespace LANES {
namespace {

template <class T>
const ExplicitLanes<T> instance = {
    kLanes<T>,
    {{{step<T, false, false, false>, step<T, false, false, true>},
      {step<T, false, true, false>, step<T, false, true, true>}},
     {{step<T, true, false, false>, step<T, true, false, true>},
      {step<T, true, true, false>, step<T, true, true, true>}}},
    {{slow<T, false, kStill>, slow<T, false, kPressure>, slow<T, false, kMoving>},
     {slow<T, true, kStill>, slow<T, true, kPressure>, slow<T, true, kMoving>}},
};

}  // namespace
}  // namespace LANES

DEFINE_LANES(ExplicitLanes<float>, instance<float>)
DEFINE_LANES(ExplicitLanes<double>, instance<double>)

}  // namespace minicloth
