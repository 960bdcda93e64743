"""Task definitions: one file a task, stated in numbers."""
