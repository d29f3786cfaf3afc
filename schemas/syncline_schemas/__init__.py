"""What bytes mean: frame batches, the capture file, CANopen vocabulary, devices and the decoder."""
