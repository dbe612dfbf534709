"""Bad learners: trainers that lie, or have gone wrong, to test that no feature version can cost the vehicle."""
