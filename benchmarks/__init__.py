"""What the project's speed is measured by; nothing in the packages depends on it, and none of it asserts."""
