"""Mathematics of calibration on arrays: numpy, scipy, joblib; no file, no port, no screen."""
