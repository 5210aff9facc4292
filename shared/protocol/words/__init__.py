"""What people write and read for messages. Never here: what the messages mean."""
