#pragma once
namespace realtime_tools
{
template <typename Kind>
class RealtimeBuffer
{
public:
  void writeFromNonRT(const Kind & value) { value_ = value; }
  Kind * readFromRT() { return &value_; }

private:
  Kind value_{};
};
}  // namespace realtime_tools
