// SPDX-License-Identifier: Apache-2.0

// Objects of the HDF5 library.
#pragma once

#include <hdf5.h>

#include <string>
#include <utility>

namespace evpose::client {

// Closes an identifier with its function.
class Hdf5Handle {
 public:
  using Closer = herr_t (*)(hid_t);

  Hdf5Handle() = default;
  Hdf5Handle(hid_t id, Closer closer) : id_(id), closer_(closer) {}
  Hdf5Handle(Hdf5Handle&& other) noexcept : id_(std::exchange(other.id_, -1)), closer_(other.closer_) {}
  Hdf5Handle& operator=(Hdf5Handle&& other) noexcept {
    std::swap(id_, other.id_);
    std::swap(closer_, other.closer_);
    return *this;
  }
  ~Hdf5Handle() { (void)Close(); }

  bool ok() const { return id_ >= 0; }
  hid_t id() const { return id_; }
  // Leaves the object open until the end of the process.
  void Leak() { id_ = -1; }
  // False if what was written is not in the file.
  bool Close() { return id_ < 0 || closer_(std::exchange(id_, -1)) >= 0; }

 private:
  hid_t id_ = -1;
  Closer closer_ = nullptr;
};

// The rows of the tables of events, triggers and their indexes in memory.
struct CdRow {
  uint16_t x, y;
  int16_t p;
  int64_t t;
};
struct TriggerRow {
  int16_t p;
  int64_t t;
  int16_t id;
};
struct IndexRow {
  uint64_t id;
  int64_t ts;
};
Hdf5Handle CdRowType();
Hdf5Handle TriggerRowType();
Hdf5Handle IndexRowType();

// Turns off the library's reports on standard error; errors are taken from LibraryError(). Objects that are open at the
// end of the process are not closed by the library. To be called before its other functions.
void SetUpLibrary();
// The library's description of the error of the last call that failed, ": ...", or an empty text.
std::string LibraryError();

}  // namespace evpose::client
