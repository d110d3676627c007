#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Runs ccache with a compiler. CMake gives clang the precompiled header by its absolute path after -Xclang, which ccache does not make
# relative to the checkout, so that it would find no object of another one.
#   tests/compile.sh CCACHE COMPILER ARGUMENT...
for argument; do
  shift
  case $argument in
    "$PWD"/CMakeFiles/*/cmake_pch.hxx*) argument=${argument#"$PWD"/} ;;
  esac
  set -- "$@" "$argument"
done
exec "$@"
