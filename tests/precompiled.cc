// SPDX-License-Identifier: Apache-2.0

// Empty source of the library that has the precompiled headers of the tests.
