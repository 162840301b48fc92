// Compiled once per instruction set; LANES names the namespace.
#include <algorithm>

#include "core.hpp"
#include "near.hpp"
#include "shear.hpp"
#include "slow.hpp"
#include "step.hpp"

namespace minicloth {
namespace LANES {
namespace {

template <class T>
const ExplicitLanes<T> instance = {
    kLanes<T>,
    {{step<T, false, Part::kFree>, step<T, false, Part::kBodies>, step<T, false, Part::kLast>},
     {step<T, true, Part::kFree>, step<T, true, Part::kBodies>, step<T, true, Part::kLast>}},
    {{{nullptr, slow<T, false, false, true>}, {slow<T, false, true, false>, slow<T, false, true, true>}},
     {{slow<T, true, false, false>, slow<T, true, false, true>},
      {slow<T, true, true, false>, slow<T, true, true, true>}}},
    near<T>,
    slant<T>,
    apart<T>,
};

}  // namespace
}  // namespace LANES

DEFINE_LANES(ExplicitLanes<float>, instance<float>)
DEFINE_LANES(ExplicitLanes<double>, instance<double>)

}  // namespace minicloth
