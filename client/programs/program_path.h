// SPDX-License-Identifier: Apache-2.0

// Finds other programs of the project.
#pragma once

#include <optional>
#include <string>

namespace evpose::client {

// Returns the path of a program: beside this one, otherwise in the folder `in_build` of the same build, relative to
// that of this program, otherwise in PATH. nullopt if there is none.
std::optional<std::string> FindProgram(const std::string& name, const std::string& in_build);

// Returns a path to the same file that a program does not take for an option: "./-x" for "-x".
std::string PathArgument(const std::string& path);

}  // namespace evpose::client
