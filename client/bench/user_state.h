// SPDX-License-Identifier: Apache-2.0

// The states of a virtual user (virtual_user.h), with their only transition function. The table is in
// client/bench/README.md.
#pragma once

namespace evpose::client {

enum class UserState {
  kWaiting,    // for the creation of a session
  kCreating,   // CreateSession is under way
  kBroken,     // the session has no stream
  kAttaching,  // a stream was opened
  kStreaming,  // events are sent
  kDeleting,   // DeleteSession is under way
  kOver,       // no further session; final
};
inline constexpr int kNumUserStates = 7;

enum class UserInput {
  kCreate,    // CreateSession is called
  kCreated,   // it has succeeded
  kRefused,   // it has failed, and is repeated later
  kStop,      // no session follows: the user ends, or the creation has failed for good
  kAttach,    // a stream is opened
  kAttached,  // the server has accepted the stream
  kLost,      // the stream has ended with an error that may pass
  kDelete,    // DeleteSession is called
  kDeleted,   // it has ended
};
inline constexpr int kNumUserInputs = 9;

// The state after `input`; the same state where the input does not apply.
UserState NextState(UserState state, UserInput input);

}  // namespace evpose::client
