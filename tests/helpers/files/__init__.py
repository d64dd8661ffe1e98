"""Files of pictures, frames and spectra, as other programs write them."""
