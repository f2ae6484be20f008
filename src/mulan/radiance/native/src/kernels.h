// The operations as one instruction set's build offers them; signatures are those of the C interface.
#pragma once
#include "workspace.h"

namespace mulan {

struct Kernels {
    const char* instruction_set;
    decltype(&mulan_train_step) train_step;
    decltype(&mulan_gradients) gradients;
    decltype(&mulan_render) render;
    decltype(&mulan_sample) sample;
    decltype(&mulan_density) density;
    decltype(&mulan_occupancy_refresh) occupancy_refresh;
    decltype(&mulan_encode) encode;
    decltype(&mulan_encode_backward) encode_backward;
    decltype(&mulan_harmonics) harmonics;
    decltype(&mulan_harmonics_backward) harmonics_backward;
    decltype(&mulan_march) march;
    decltype(&mulan_networks) networks;
    decltype(&mulan_networks_backward) networks_backward;
    decltype(&mulan_composite) composite;
    decltype(&mulan_composite_backward) composite_backward;
    decltype(&mulan_adam) adam;
};

// The build for this processor, or the one chosen by choose_kernels.
const Kernels& kernels();
bool choose_kernels(const char* instruction_set);

}  // namespace mulan
