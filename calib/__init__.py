"""Mathematics of calibration on arrays: knows numpy, scipy and joblib, no file, no port, no screen."""
