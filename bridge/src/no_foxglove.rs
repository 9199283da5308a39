//! The bridge without Foxglove's server: built without the feature `foxglove`.

use crate::config::Config;
use crate::shared::Shared;
use crate::stop::StopDesk;
use std::sync::Arc;
use std::thread::JoinHandle;

/// Fails if the configuration demands the server.
pub(crate) fn start(
    config: &Config,
    _shared: &Arc<Shared>,
    _desk: &Arc<StopDesk>,
) -> Result<Option<JoinHandle<()>>, String> {
    if config.foxglove.enabled {
        return Err("[foxglove]: this bridge was built without the feature `foxglove`".to_owned());
    }
    Ok(None)
}
