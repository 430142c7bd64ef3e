//! Widths of the two networks, and where their weights lie in one flat vector.

use std::ops::Range;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::Layer;
use crate::parameters::OUTPUTS;

/// One fully connected layer within the flat vector: weights `[input][output]`, then biases.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LayerPlace {
    pub inputs: usize,
    pub outputs: usize,
    pub weights: Range<usize>,
    pub biases: Range<usize>,
}

/// Positions of the layers of VI-MLP and RL-MLP, in this order, in the flat vector.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Shape {
    pub vi: Vec<LayerPlace>,
    pub rl: Vec<LayerPlace>,
    /// Length of the flat vector.
    pub len: usize,
}

impl Shape {
    /// Creates the shape; both networks have two outputs: v, i and R, L.
    pub fn new(vi: (usize, &[usize]), rl: (usize, &[usize])) -> Self {
        let mut len = 0;
        let mut place = |(mut inputs, hidden): (usize, &[usize])| {
            let widths = hidden.iter().copied().chain([OUTPUTS]);
            widths
                .map(|outputs| {
                    let weights = len..len + inputs * outputs;
                    let biases = weights.end..weights.end + outputs;
                    len = biases.end;
                    let place = LayerPlace {
                        inputs,
                        outputs,
                        weights,
                        biases,
                    };
                    inputs = outputs;
                    place
                })
                .collect()
        };
        let (vi, rl) = (place(vi), place(rl));
        Self { vi, rl, len }
    }

    /// All layers, in the order of the flat vector.
    pub fn layers(&self) -> impl Iterator<Item = &LayerPlace> {
        self.vi.iter().chain(&self.rl)
    }

    /// Xavier-Glorot uniform weights and zero biases from `seed` (paper, section V).
    pub fn xavier(&self, seed: u64) -> Vec<f32> {
        // Drawn here and not by burn, so that every backend starts from the same digits.
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut theta = vec![0.0; self.len];
        for layer in self.layers() {
            let limit = (6.0 / (layer.inputs + layer.outputs) as f64).sqrt();
            for weight in &mut theta[layer.weights.clone()] {
                *weight = rng.random_range(-limit..limit) as f32;
            }
        }
        theta
    }

    /// The layers at `places`, in double precision.
    pub fn extract(places: &[LayerPlace], theta: &[f32]) -> Vec<Layer> {
        let wide = |range: &Range<usize>| theta[range.clone()].iter().map(|x| f64::from(*x));
        let layer = |place: &LayerPlace| Layer {
            inputs: place.inputs,
            outputs: place.outputs,
            weights: wide(&place.weights).collect(),
            biases: wide(&place.biases).collect(),
        };
        places.iter().map(layer).collect()
    }

    /// Writes `layers` to `places`; returns `false` if their shapes differ.
    pub fn insert(places: &[LayerPlace], layers: &[Layer], theta: &mut [f32]) -> bool {
        let fits = |(p, l): (&LayerPlace, &Layer)| {
            (p.inputs, p.outputs) == (l.inputs, l.outputs)
                && p.weights.len() == l.weights.len()
                && p.biases.len() == l.biases.len()
        };
        if places.len() != layers.len() || !places.iter().zip(layers).all(fits) {
            return false;
        }
        for (place, layer) in places.iter().zip(layers) {
            let values = layer.weights.iter().chain(&layer.biases);
            let slots = &mut theta[place.weights.start..place.biases.end];
            for (slot, value) in slots.iter_mut().zip(values) {
                *slot = *value as f32;
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::Shape;

    #[test]
    fn the_papers_networks_have_their_parameters_without_gaps() {
        let shape = Shape::new((6, &[64; 3]), (2, &[16; 4]));
        // 6-64-64-64-2 and 2-16-16-16-16-2, weights and biases.
        let vi = 6 * 64 + 64 + 2 * (64 * 64 + 64) + 64 * 2 + 2;
        let rl = 2 * 16 + 16 + 3 * (16 * 16 + 16) + 16 * 2 + 2;
        assert_eq!(shape.len, vi + rl);
        let mut end = 0;
        for layer in shape.layers() {
            assert_eq!(layer.weights.start, end);
            assert_eq!(layer.biases.start, layer.weights.end);
            end = layer.biases.end;
        }
    }

    #[test]
    fn xavier_stays_within_its_limits_and_follows_the_seed() {
        let shape = Shape::new((6, &[64; 3]), (2, &[16; 4]));
        let theta = shape.xavier(3);
        assert_eq!(theta, shape.xavier(3));
        assert_ne!(theta, shape.xavier(4));
        for layer in shape.layers() {
            let limit = (6.0 / (layer.inputs + layer.outputs) as f32).sqrt();
            let weights = &theta[layer.weights.clone()];
            let largest = weights.iter().fold(0.0_f32, |m, w| m.max(w.abs()));
            assert!(largest <= limit && largest > 0.8 * limit);
            assert!(theta[layer.biases.clone()].iter().all(|b| *b == 0.0));
        }
    }

    #[test]
    fn layers_survive_the_flat_vector() {
        let shape = Shape::new((4, &[5]), (2, &[3]));
        let theta = shape.xavier(1);
        let layers = Shape::extract(&shape.rl, &theta);
        let mut copy = vec![0.0; shape.len];
        assert!(Shape::insert(&shape.rl, &layers, &mut copy));
        assert_eq!(
            copy[shape.rl[0].weights.start..],
            theta[shape.rl[0].weights.start..]
        );
        assert!(!Shape::insert(&shape.vi, &layers, &mut copy));
    }
}
