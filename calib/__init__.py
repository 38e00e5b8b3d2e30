"""Mathematics of calibration on arrays: knows numpy and scipy, no file, no port, no screen."""
