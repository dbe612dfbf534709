"""The learner alone, on any data: features, last layer, trainer and swap of the flight, without a vehicle."""
