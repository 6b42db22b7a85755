#pragma once
#define PLUGINLIB_EXPORT_CLASS(kind, base) \
  base * made() { return new kind(); }
