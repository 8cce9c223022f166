//! Reconstruction: from posed photos to a surfel cloud (ComGS §3.1.1, "Step 1").
//!
//! The loss is Eq. 5: photometric (Eq. 2), depth-normal consistency (Eq. 3) and, where there are masks, mask
//! cross-entropy (Eq. 4). It is built for few cores: it starts near the answer ([`init`]: visual hull for objects with
//! masks, plane sweep for scenes, structure-from-motion points where a capture brings them), trains coarse to fine,
//! and spends a fixed budget of surfels where several views agree that the error is ([`density`]).
//!
//! Nothing here touches a file: checkpoints are bytes that the caller stores.

pub mod checkpoint;
pub mod config;
pub mod decompose;
pub mod density;
pub mod geometry_loss;
pub mod init;
pub mod train;
pub mod view;

pub use config::{Kind, Quality, TrainConfig};
pub use decompose::{AlbedoScale, DecomposeConfig, DecomposeReport, Decomposed, Visibility, decompose};
pub use train::{Observer, TrainError, TrainReport, TrainStatus, Trained, train};
pub use view::TrainView;
