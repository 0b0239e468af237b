//! Weights of levels, interpolated from one intensity grid to another.

/// Positions of `places` among `nodes`, which increase: the node below, and the distance towards the next one, 0 to 1.
/// Places beyond the ends are moved to the ends.
pub(super) fn among(nodes: &[f32], places: impl Iterator<Item = f32>) -> Vec<(usize, f32)> {
    places
        .map(|place| {
            let below = nodes.partition_point(|&node| node <= place).clamp(1, nodes.len() - 1) - 1;
            let width = nodes[below + 1] - nodes[below];
            (below, ((place - nodes[below]) / width).clamp(0.0, 1.0))
        })
        .collect()
}

/// Interpolates rows of weights of `from`, one for each node and one more, to rows for each of the [places](among) and one
/// more, which is copied.
pub(super) fn carry(from: &[f32], nodes: usize, places: &[(usize, f32)], to: &mut [f32]) {
    for (to, from) in to.chunks_exact_mut(places.len() + 1).zip(from.chunks_exact(nodes + 1)) {
        for (to, &(node, share)) in to.iter_mut().zip(places) {
            *to = (1.0 - share) * from[node] + share * from[node + 1];
        }
        to[places.len()] = from[nodes];
    }
}

/// The transpose of [`carry`]: adds the gradients by the weights of places to those by the weights of nodes.
pub(super) fn carry_back(by_places: &[f32], places: &[(usize, f32)], nodes: usize, by_nodes: &mut [f32]) {
    for (by, out) in by_places.chunks_exact(places.len() + 1).zip(by_nodes.chunks_exact_mut(nodes + 1)) {
        for (by, &(node, share)) in by.iter().zip(places) {
            out[node] += (1.0 - share) * by;
            out[node + 1] += share * by;
        }
        out[nodes] += by[places.len()];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_carried_exactly_and_ends_are_held() {
        let nodes = [-1.0, 0.0, 2.0, 5.0];
        let places = among(&nodes, [-3.0, -1.0, 0.5, 2.0, 4.0, 5.0, 9.0].into_iter());
        let from: Vec<f32> =
            [1.0, 10.0].iter().flat_map(|slope| nodes.map(|x| slope * x).into_iter().chain([7.0])).collect();
        let mut to = vec![0.0; 16];
        carry(&from, 4, &places, &mut to);
        assert_eq!(to[..8], [-1.0, -1.0, 0.5, 2.0, 4.0, 5.0, 5.0, 7.0]);
        assert_eq!(to[8..], [-10.0, -10.0, 5.0, 20.0, 40.0, 50.0, 50.0, 7.0]);
        // The transpose has the same inner products.
        let by: Vec<f32> = (0..16).map(|i| (i * 5 % 7) as f32 - 3.0).collect();
        let mut back = vec![0.0; 10];
        carry_back(&by, &places, 4, &mut back);
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
        assert!((dot(&by, &to) - dot(&back, &from)).abs() < 1e-3);
    }
}
