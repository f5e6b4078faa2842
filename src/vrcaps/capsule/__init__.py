"""The device: body, cameras with their lens models, LEDs; a catalog of named devices."""
