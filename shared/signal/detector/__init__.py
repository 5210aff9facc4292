"""What the receiver makes of the data of an array: tests of many looks, echoes told apart."""
