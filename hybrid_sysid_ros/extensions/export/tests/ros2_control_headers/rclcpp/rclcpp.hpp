#pragma once
#include <cstdio>
#include <memory>
#include <string>

namespace rclcpp
{
struct Time
{
  double at;
  double seconds() const { return at; }
};
struct Duration
{
};
struct SystemDefaultsQoS
{
};
struct Logger
{
};
template <typename Message>
struct Subscription
{
  using SharedPtr = std::shared_ptr<Subscription<Message>>;
};
struct Node
{
  Logger get_logger() const { return {}; }
  const char * get_name() const { return "controller"; }
  template <typename Message, typename Callback>
  std::shared_ptr<Subscription<Message>> create_subscription(const std::string &, SystemDefaultsQoS, Callback callback)
  {
    void (*check)(Callback &, std::shared_ptr<Message>) = [](Callback & call, std::shared_ptr<Message> message) {
      call(message);
    };
    (void)check, (void)callback;
    return std::make_shared<Subscription<Message>>();
  }
};
}  // namespace rclcpp

#define RCLCPP_ERROR(logger, ...) ((void)(logger), std::fprintf(stderr, __VA_ARGS__))
#define RCLCPP_WARN(logger, ...) ((void)(logger), std::fprintf(stderr, __VA_ARGS__))
