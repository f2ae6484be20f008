// This build's operations, for dispatch.cpp to choose from.
#include "kernels.h"


namespace mulan::MULAN_ISA {

decltype(mulan_train_step) train_step;
decltype(mulan_gradients) gradients;
decltype(mulan_render) render;
decltype(mulan_sample) sample;
decltype(mulan_density) density;
decltype(mulan_occupancy_refresh) occupancy_refresh;
decltype(mulan_encode) encode;
decltype(mulan_encode_backward) encode_backward;
decltype(mulan_harmonics) harmonics;
decltype(mulan_harmonics_backward) harmonics_backward;
decltype(mulan_march) march;
decltype(mulan_networks) networks;
decltype(mulan_networks_backward) networks_backward;
decltype(mulan_composite) composite;
decltype(mulan_composite_backward) composite_backward;
decltype(mulan_adam) adam;

extern const Kernels table;
const Kernels table = {MULAN_ISA_NAME, train_step, gradients, render, sample, density, occupancy_refresh, encode,
                       encode_backward, harmonics, harmonics_backward, march, networks, networks_backward, composite,
                       composite_backward, adam};

}  // namespace mulan::MULAN_ISA
