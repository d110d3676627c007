// SPDX-License-Identifier: Apache-2.0

// The order in which sessions have their turns, without threads and clocks (README.md).
#pragma once

#include <chrono>
#include <cstddef>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace evpose::server {

// Bounds of the processor time, in processor seconds per second; 0: no bound.
struct CpuLimits {
  double session = 0.0;
  double tenant = 0.0;  // processor seconds per second of all sessions of a tenant together
};

// The processor time that a session or a tenant uses.
class CpuMeter {
 public:
  using Time = std::chrono::steady_clock::time_point;

  // `limit`: as in CpuLimits.
  void Charge(std::chrono::nanoseconds cpu, Time now, double limit);
  // Processor seconds per second, averaged with a time constant of one second.
  double Rate(Time now) const;
  // The limit permits more work from this time on.
  Time free_at() const { return free_at_; }

 private:
  double rate_ = 0.0;  // at charged_at_
  Time charged_at_{};
  Time free_at_{};
};

// kLive: data arrive as a camera records them; kBulk: faster, as those of a replay at full speed (ArrivalMonitor).
enum class Arrival { kLive, kBulk };

struct TenantShare {
  double used_s = 0.0;  // processor time; after idle time raised to at most kCreditS (.cc) below the others
  // Virtual clock of the tenant: the largest SessionShare::used_s of a session at its turn by share. A session that
  // becomes active starts at most kCreditS (.cc) below it.
  double clock_s = 0.0;
  // Sessions that wait or have their turn.
  size_t num_live = 0;
  size_t num_bulk = 0;
  CpuMeter meter;

  size_t& NumActive(Arrival arrival) { return arrival == Arrival::kLive ? num_live : num_bulk; }
};

struct SessionShare {
  std::shared_ptr<TenantShare> tenant;
  CpuMeter::Time received_at{};  // time of the oldest data that wait
  Arrival arrival = Arrival::kLive;
  bool is_active = false;          // it waits or has its turn
  bool has_priority_turn = false;  // its present or last turn was by its priority, and not by its share
  // Processor time, seconds, compared among the sessions of the tenant as TenantShare::used_s is among the tenants. The
  // time of turns by priority is not counted. Beside replays of the tenant, a part of the time of a live session is
  // counted (kLiveWeight in the .cc).
  double used_s = 0.0;
  std::chrono::nanoseconds since_drained{0};  // processor time since the queue was last empty
  CpuMeter::Time drained_at{};                // when the queue was last empty
  CpuMeter::Time paced_since{};               // the session has kept its pace since
  CpuMeter meter;

  // To be called when data are received and no other data wait.
  void RecordDrained(CpuMeter::Time now);
  // The data arrive no faster than they are processed: the measure of a live camera, as opposed to a replay.
  bool KeepsPace() const;
};

// Not thread-safe. The caller keeps the shares until they have been popped.
class FairQueue {
 public:
  using Time = CpuMeter::Time;

  explicit FairQueue(const CpuLimits& limits) : limits_(limits) {}

  std::shared_ptr<TenantShare> FindTenant(const std::string& name);
  // The session waits after it was idle.
  void Add(SessionShare& session);
  // The session waits for its next turn.
  void Push(SessionShare& session) { waiting_.push_back(&session); }
  // The session is idle. Precondition: it was popped.
  void Remove(SessionShare& session);
  // To be used instead of an assignment: a session that is active is counted by its arrival.
  static void SetArrival(SessionShare& session, Arrival arrival);
  // Removes the session that has the next turn. Null: none waits, or those that wait have reached their limits.
  SessionShare* Pop(Time now);
  void Charge(SessionShare& session, std::chrono::nanoseconds cpu, Time now);
  // The time from which Pop() returns a session; absent if none waits.
  std::optional<Time> NextTurnAt() const;
  void RemoveLimits() { has_limits_ = false; }

  size_t size() const { return waiting_.size(); }

 private:
  Time FreeAt(const SessionShare& session) const;
  struct Choice {
    std::vector<SessionShare*>::iterator session;  // the end of waiting_ if all have reached their limits
    bool has_priority = false;
  };
  // Chooses the session that has the next turn, and counts the turns by priority.
  Choice Choose(Time now);

  const CpuLimits limits_;
  bool has_limits_ = true;
  double clock_s_ = 0.0;       // the largest TenantShare::used_s with which a tenant was chosen
  int turns_by_priority_ = 0;  // since a session without priority had a turn or none waited
  std::map<std::string, std::weak_ptr<TenantShare>> tenants_;
  std::vector<SessionShare*> waiting_;  // in the order of Push()
};

}  // namespace evpose::server
