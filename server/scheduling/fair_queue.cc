// SPDX-License-Identifier: Apache-2.0
#include "server/scheduling/fair_queue.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>

namespace evpose::server {
namespace {

// Processor time within which a session that keeps its pace processes all data that wait. kBulk: the data of 10 ms at
// the highest cost that one thread can process in real time. kLive: a search for the objects, too, and what arrives
// during it.
constexpr std::chrono::milliseconds kBulkPaceTime{10};
constexpr std::chrono::milliseconds kLivePaceTime{100};
// A session that has kept its pace for some time may need more after a disturbance, this part of that time, so that a
// camera does not lose its priority by the delay that others have caused. A session that replays a recording does not
// receive this allowance, because it does not keep a constant pace.
constexpr int kEarnedPart = 5;
constexpr std::chrono::milliseconds kMostEarned{500};
// Processor time by which a tenant or session may be behind the others after it was idle. It must be longer than
// kLeadS, so that a tenant that uses less than its share comes before one that uses more.
constexpr double kCreditS = 0.1;
// Processor time, seconds, by which a tenant may be ahead of the others and its sessions still keep their priority.
// With less, the ordinary variation of the turns would cost cameras their priority.
constexpr double kLeadS = 0.05;
// The live sessions of a tenant get this many times the time of its others, or an equal share for each session if that
// is more. With equal shares, a camera that needs more beside replays of its tenant would never catch up after it has
// lost its priority, by an expensive search or on a busy machine.
constexpr double kLiveWeight = 7.0;
// Turns by priority in a row while another session waits, so that those without priority continue, however slowly, when
// cameras take all the time.
constexpr int kMostTurnsByPriority = 15;
// Time constant of CpuMeter::Rate(), seconds.
constexpr double kMeanS = 1.0;
// A session or tenant that was idle may use at once the processor time that its limit permits in this time.
constexpr std::chrono::milliseconds kBurst{100};

double Seconds(std::chrono::nanoseconds duration) { return std::chrono::duration<double>(duration).count(); }

bool HasPriority(const SessionShare& session, double least_used_s) {
  return session.KeepsPace() && session.tenant->used_s <= least_used_s + kLeadS;
}

// Returns whether `a` precedes `b` among sessions without priority: by the tenant's time, then by the session's.
bool HasUsedLess(const SessionShare& a, const SessionShare& b) {
  return std::tie(a.tenant->used_s, a.used_s) < std::tie(b.tenant->used_s, b.used_s);
}

// The part of a session's processor time that is counted among the sessions of its tenant.
double CountedPart(const SessionShare& session) {
  const TenantShare& tenant = *session.tenant;
  if (session.arrival == Arrival::kBulk || tenant.num_bulk == 0) return 1.0;
  return std::min(1.0, static_cast<double>(tenant.num_live) / (kLiveWeight * static_cast<double>(tenant.num_bulk)));
}

}  // namespace

void CpuMeter::Charge(std::chrono::nanoseconds cpu, Time now, double limit) {
  rate_ = Rate(now) + Seconds(cpu) / kMeanS;
  charged_at_ = now;
  if (limit <= 0.0) return;
  const std::chrono::duration<double> duration(Seconds(cpu) / limit);
  free_at_ = std::max(free_at_, now - kBurst) + std::chrono::duration_cast<std::chrono::nanoseconds>(duration);
}

double CpuMeter::Rate(Time now) const { return rate_ * std::exp(-std::max(0.0, Seconds(now - charged_at_)) / kMeanS); }

void SessionShare::RecordDrained(CpuMeter::Time now) {
  if (paced_since == CpuMeter::Time()) paced_since = now;
  since_drained = {};
  drained_at = now;
}

bool SessionShare::KeepsPace() const {
  const std::chrono::nanoseconds earned = (drained_at - paced_since) / kEarnedPart;
  const std::chrono::nanoseconds allowed = arrival == Arrival::kLive ? kLivePaceTime : kBulkPaceTime;
  return since_drained < allowed + std::clamp<std::chrono::nanoseconds>(earned, std::chrono::seconds(0), kMostEarned);
}

std::shared_ptr<TenantShare> FairQueue::FindTenant(const std::string& name) {
  std::erase_if(tenants_, [](const auto& entry) { return entry.second.expired(); });
  std::weak_ptr<TenantShare>& known = tenants_[name];
  std::shared_ptr<TenantShare> tenant = known.lock();
  if (tenant == nullptr) known = tenant = std::make_shared<TenantShare>();
  return tenant;
}

void FairQueue::Add(SessionShare& session) {
  Push(session);  // first, because it may throw
  TenantShare& tenant = *session.tenant;
  const bool was_idle = tenant.num_live + tenant.num_bulk == 0;
  if (was_idle) tenant.used_s = std::max(tenant.used_s, clock_s_ - kCreditS);
  session.used_s = std::max(session.used_s, tenant.clock_s - kCreditS);
  session.is_active = true;
  ++tenant.NumActive(session.arrival);
}

void FairQueue::Remove(SessionShare& session) {
  session.is_active = false;
  --session.tenant->NumActive(session.arrival);
}

void FairQueue::SetArrival(SessionShare& session, Arrival arrival) {
  if (session.is_active) {
    --session.tenant->NumActive(session.arrival);
    ++session.tenant->NumActive(arrival);
  }
  session.arrival = arrival;
}

FairQueue::Time FairQueue::FreeAt(const SessionShare& session) const {
  return has_limits_ ? std::max(session.meter.free_at(), session.tenant->meter.free_at()) : Time::min();
}

FairQueue::Choice FairQueue::Choose(Time now) {
  double least_used_s = std::numeric_limits<double>::infinity();
  for (const SessionShare* session : waiting_) {
    if (FreeAt(*session) <= now) least_used_s = std::min(least_used_s, session->tenant->used_s);
  }
  const auto none = waiting_.end();
  auto by_priority = none, by_share = none;
  for (auto next = waiting_.begin(); next != none; ++next) {
    const SessionShare& session = **next;
    if (FreeAt(session) > now) continue;
    if (HasPriority(session, least_used_s)) {
      if (by_priority == none || session.received_at < (*by_priority)->received_at) by_priority = next;
    } else if (by_share == none || HasUsedLess(session, **by_share)) {
      by_share = next;
    }
  }
  const bool has_priority = by_priority != none && (by_share == none || turns_by_priority_ < kMostTurnsByPriority);
  turns_by_priority_ = has_priority && by_share != none ? turns_by_priority_ + 1 : 0;
  return {has_priority ? by_priority : by_share, has_priority};
}

SessionShare* FairQueue::Pop(Time now) {
  const auto [next, has_priority] = Choose(now);
  if (next == waiting_.end()) return nullptr;
  SessionShare* const session = *next;
  waiting_.erase(next);
  session->has_priority_turn = has_priority;
  TenantShare& tenant = *session->tenant;
  clock_s_ = std::max(clock_s_, tenant.used_s);
  if (!has_priority) tenant.clock_s = std::max(tenant.clock_s, session->used_s);
  return session;
}

void FairQueue::Charge(SessionShare& session, std::chrono::nanoseconds cpu, Time now) {
  if (!session.has_priority_turn) session.used_s += CountedPart(session) * Seconds(cpu);
  session.since_drained += cpu;
  if (!session.KeepsPace()) session.paced_since = now;
  session.meter.Charge(cpu, now, limits_.session);
  session.tenant->used_s += Seconds(cpu);
  session.tenant->meter.Charge(cpu, now, limits_.tenant);
}

std::optional<FairQueue::Time> FairQueue::NextTurnAt() const {
  std::optional<Time> next;
  for (const SessionShare* session : waiting_) next = std::min(next.value_or(Time::max()), FreeAt(*session));
  return next;
}

}  // namespace evpose::server
