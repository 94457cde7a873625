// train/torch.h - the parts of libtorch that train/ uses; precompiled, for they take longer than all of our code.
//
// Networks here are functions of named tensors, as in model/reference.h: names in memory are names in the file, so
// the headers of torch::nn, torch::optim and torch::data are not needed.
#pragma once

#include <ATen/ATen.h>
#include <ATen/Parallel.h>
#include <torch/csrc/autograd/custom_function.h>
#include <torch/cuda.h>
#include <torch/types.h>
