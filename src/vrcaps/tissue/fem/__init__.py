"""The wall as a layer of finite elements."""
