// SPDX-License-Identifier: Apache-2.0

// Included before every file that is compiled for arm64. Eigen's kernels for NEON call the fused multiply-add by name,
// which -ffp-contract=off does not prevent. Its result differs in the last bit from that of a product and a sum, which
// x86-64 computes: a session's poses would depend on the processor.
#pragma once

#include <arm_neon.h>

#define vfma_f32(c, a, b) vadd_f32(c, vmul_f32(a, b))
#define vfmaq_f32(c, a, b) vaddq_f32(c, vmulq_f32(a, b))
#define vfmaq_f64(c, a, b) vaddq_f64(c, vmulq_f64(a, b))
#define vfmaq_n_f32(c, a, b) vaddq_f32(c, vmulq_n_f32(a, b))
#define vfmaq_n_f64(c, a, b) vaddq_f64(c, vmulq_n_f64(a, b))
#define vfmaq_laneq_f32(c, a, b, lane) vaddq_f32(c, vmulq_laneq_f32(a, b, lane))
#define vfmaq_laneq_f64(c, a, b, lane) vaddq_f64(c, vmulq_laneq_f64(a, b, lane))
